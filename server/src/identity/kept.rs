//! What is remembered of browsers, each under an id that only its browser knows: bounded in all, and for each owner.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::tokens::{TokenHash, hash_of, hex};

/// A secret that nobody guesses: 256 random bits in hexadecimal digits.
pub(super) fn secret() -> Result<String, getrandom::Error> {
    let mut random = [0; 32];
    getrandom::fill(&mut random)?;
    Ok(hex(&random))
}

/// Values under secret ids, for a time.
pub(super) struct Kept<V> {
    most: usize,
    each: usize,
    lasts: Duration,
    entries: Mutex<HashMap<TokenHash, Entry<V>>>,
}

struct Entry<V> {
    value: V,
    owner: String,
    until: Instant,
}

impl<V: Clone> Kept<V> {
    /// So many in all, so many of one owner, each for so long.
    pub(super) fn new(most: usize, each: usize, lasts: Duration) -> Self {
        Self { most, each, lasts, entries: Mutex::default() }
    }

    /// Keeps a value; returns its id, which is known to nobody else. Where there are too many, of its owner or in all, the one
    /// of whoever has the most goes that would end first.
    pub(super) fn put(&self, owner: &str, value: V, now: Instant) -> Result<String, getrandom::Error> {
        let id = secret()?;
        let mut entries = self.locked();
        entries.retain(|_, entry| entry.until > now);
        let own = entries.values().filter(|entry| entry.owner == owner).count();
        if own >= self.each {
            make_room(&mut entries, owner);
        } else if entries.len() >= self.most {
            let greedy = greedy(&entries);
            make_room(&mut entries, &greedy);
        }
        let entry = Entry { value, owner: owner.to_owned(), until: now + self.lasts };
        entries.insert(hash_of(&id), entry);
        Ok(id)
    }

    /// The value under an id.
    pub(super) fn get(&self, id: &str, now: Instant) -> Option<V> {
        let entries = self.locked();
        let entry = entries.get(&hash_of(id)).filter(|entry| entry.until > now);
        entry.map(|entry| entry.value.clone())
    }

    /// The value under an id, which is forgotten.
    pub(super) fn take(&self, id: &str, now: Instant) -> Option<V> {
        let entry = self.locked().remove(&hash_of(id)).filter(|entry| entry.until > now);
        entry.map(|entry| entry.value)
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, HashMap<TokenHash, Entry<V>>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Who has the most.
fn greedy<V>(entries: &HashMap<TokenHash, Entry<V>>) -> String {
    let mut counts: HashMap<&str, usize> = HashMap::new();
    for entry in entries.values() {
        *counts.entry(&entry.owner).or_default() += 1;
    }
    let most = counts.into_iter().max_by_key(|(_, count)| *count);
    most.map(|(owner, _)| owner.to_owned()).unwrap_or_default()
}

fn make_room<V>(entries: &mut HashMap<TokenHash, Entry<V>>, owner: &str) {
    let own = entries.iter().filter(|(_, entry)| entry.owner == owner);
    let first = own.min_by_key(|(_, entry)| entry.until).map(|(id, _)| *id);
    first.map(|id| entries.remove(&id));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_end_when_they_are_taken_or_in_time() {
        let (kept, now) = (Kept::new(8, 8, Duration::from_mins(1)), Instant::now());
        let id = kept.put("alice", 7, now).unwrap();
        assert_eq!((kept.get(&id, now), kept.get(&id[1..], now)), (Some(7), None));
        assert_eq!(kept.get(&id, now + Duration::from_mins(1)), None);
        assert_eq!((kept.take(&id, now), kept.take(&id, now), kept.get(&id, now)), (Some(7), None, None));
        let late = kept.put("alice", 8, now).unwrap();
        assert_eq!(kept.take(&late, now + Duration::from_secs(61)), None);
    }

    /// Catches: one owner that ends what is kept for others.
    #[test]
    fn whoever_has_the_most_makes_room() {
        let (kept, now) = (Kept::new(8, 6, Duration::from_mins(10)), Instant::now());
        let at = |s: u64| now + Duration::from_secs(s);
        let others: Vec<_> = ["alice", "bob"].map(|owner| kept.put(owner, 0, now).unwrap()).into();
        let greedy: Vec<_> = (0..50).map(|n| kept.put("mallory", n, at(n)).unwrap()).collect();
        assert!(others.iter().all(|id| kept.get(id, at(50)).is_some()));
        assert_eq!(greedy.iter().filter(|id| kept.get(id, at(50)).is_some()).count(), 6);
        assert!(kept.get(&greedy[49], at(50)).is_some(), "the newest stays");
        kept.put("carol", 0, at(50)).unwrap();
        assert_eq!(greedy.iter().filter(|id| kept.get(id, at(51)).is_some()).count(), 5);
        assert!(others.iter().all(|id| kept.get(id, at(51)).is_some()));
        // Not in one expression with the line above: the lock is held to its end.
        assert_eq!(kept.locked().len(), 8);
    }
}
