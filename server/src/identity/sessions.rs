//! Browsers that have signed in. A session stands for the token that began it, and ends with it; it is kept in memory only.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::tokens::{TokenHash, hash_of, hex};

/// The cookie that holds a session's id.
pub const COOKIE: &str = "echofix_session";
/// A session lasts no longer than a working day.
pub(super) const LASTS: Duration = Duration::from_hours(12);
/// Sessions at once, at most.
const MOST: usize = 4096;

#[derive(Default)]
pub(super) struct Sessions(Mutex<HashMap<TokenHash, Session>>);

struct Session {
    token: TokenHash,
    until: Instant,
}

impl Sessions {
    /// Begins one; returns its id, which is known to nobody else. The one that would end first makes room if need be.
    pub(super) fn begin(&self, token: TokenHash, now: Instant) -> Result<String, getrandom::Error> {
        let mut random = [0; 32];
        getrandom::fill(&mut random)?;
        let id = hex(&random);
        let mut sessions = self.locked();
        sessions.retain(|_, session| session.until > now);
        if sessions.len() >= MOST {
            let first = sessions.iter().min_by_key(|(_, session)| session.until).map(|(id, _)| *id);
            first.map(|id| sessions.remove(&id));
        }
        sessions.insert(hash_of(&id), Session { token, until: now + LASTS });
        Ok(id)
    }

    /// The token that began a session.
    pub(super) fn token(&self, id: &str, now: Instant) -> Option<TokenHash> {
        self.locked().get(&hash_of(id)).filter(|session| session.until > now).map(|session| session.token)
    }

    /// Ends one.
    pub(super) fn end(&self, id: &str) {
        self.locked().remove(&hash_of(id));
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, HashMap<TokenHash, Session>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_end_when_they_are_ended_or_in_time_and_are_bounded() {
        let (sessions, now) = (Sessions::default(), Instant::now());
        let id = sessions.begin([7; 32], now).unwrap();
        assert_eq!(sessions.token(&id, now), Some([7; 32]));
        assert_eq!(sessions.token(&id[1..], now), None);
        assert_eq!(sessions.token(&id, now + LASTS), None);
        sessions.end(&id);
        assert_eq!(sessions.token(&id, now), None);
        let first = sessions.begin([1; 32], now).unwrap();
        for _ in 0..MOST {
            sessions.begin([2; 32], now + Duration::from_secs(1)).unwrap();
        }
        assert_eq!(sessions.token(&first, now), None);
        // Not in one expression with the line above: the lock is held to its end.
        assert_eq!(sessions.locked().len(), MOST);
    }
}
