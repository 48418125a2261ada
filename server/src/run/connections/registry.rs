//! Which connections there are, and which of them goes when there are too many.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use prometheus_client::metrics::gauge::Gauge;
use tokio::sync::Notify;

use crate::shares::{Peer, part};

/// A connection that was used this recently is not idle.
const RECENT: Duration = Duration::from_secs(1);
/// One with an open call is taken for idle, where nobody else is, after so long.
const ABANDONED: Duration = Duration::from_mins(1);

/// What is known of a connection, for as long as it is open.
#[derive(Debug, Clone)]
pub(in crate::run) struct ConnectionUse(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    peer: Peer,
    opened: Instant,
    requested: AtomicBool,
    calls: AtomicUsize,
    /// Milliseconds from `opened` to when a call last began or ended.
    used_ms: AtomicU64,
    close: Arc<Notify>,
}

impl ConnectionUse {
    pub(super) fn new(peer: Peer, now: Instant) -> Self {
        Self(Arc::new(Shared {
            peer,
            opened: now,
            requested: AtomicBool::default(),
            calls: AtomicUsize::default(),
            used_ms: AtomicU64::default(),
            close: Arc::default(),
        }))
    }

    /// Whose it is.
    pub(in crate::run) fn peer(&self) -> Peer {
        self.0.peer
    }

    /// A call begins; it ends when this is dropped.
    pub(in crate::run) fn begin(&self) -> InUse {
        self.0.requested.store(true, Ordering::Relaxed);
        self.0.calls.fetch_add(1, Ordering::Relaxed);
        self.touch();
        InUse(self.clone())
    }

    /// Did a first request come?
    pub(super) fn was_requested(&self) -> bool {
        self.0.requested.load(Ordering::Relaxed)
    }

    /// For how long there has been no call; nothing while there is one.
    pub(super) fn idle(&self, now: Instant) -> Option<Duration> {
        (self.0.calls.load(Ordering::Relaxed) == 0).then(|| self.untouched(now))
    }

    /// Resolves when the connection has to make room.
    pub(super) fn closing(&self) -> tokio::sync::futures::OwnedNotified {
        self.0.close.clone().notified_owned()
    }

    fn untouched(&self, now: Instant) -> Duration {
        let used = self.0.opened + Duration::from_millis(self.0.used_ms.load(Ordering::Relaxed));
        now.saturating_duration_since(used)
    }

    fn touch(&self) {
        self.0.used_ms.store(self.0.opened.elapsed().as_millis() as u64, Ordering::Relaxed);
    }
}

/// A call of a connection, from its headers to the end of its answer.
#[derive(Debug)]
pub(in crate::run) struct InUse(ConnectionUse);

impl Drop for InUse {
    fn drop(&mut self) {
        self.0.0.calls.fetch_sub(1, Ordering::Relaxed);
        self.0.touch();
    }
}

/// The open connections of a port.
#[derive(Debug, Clone)]
pub(super) struct Registry {
    most: usize,
    each: usize,
    open: Arc<Mutex<Open>>,
    /// How many there are, for those who watch.
    count: Gauge,
}

#[derive(Debug, Default)]
struct Open {
    next: u64,
    connections: HashMap<u64, ConnectionUse>,
}

/// A connection's entry, removed when dropped.
#[derive(Debug)]
pub(super) struct Entry {
    number: u64,
    registry: Registry,
}

impl Registry {
    /// For so many connections, of which one peer may have a share.
    pub(super) fn new(most: usize, share: f64) -> Self {
        Self { most, each: part(most, share), open: Arc::default(), count: Gauge::default() }
    }

    /// Tells a gauge how many there are.
    pub(super) fn counted(self, count: Gauge) -> Self {
        Self { count, ..self }
    }

    /// Lets a connection in; where there are too many, of its peer or in all, the longest idle one goes. Nothing when none is
    /// idle.
    pub(super) fn enter(&self, connection: &ConnectionUse, now: Instant) -> Option<Entry> {
        let mut open = self.lock();
        let peer = connection.peer();
        let own = open.connections.values().filter(|open| open.peer() == peer).count();
        if own >= self.each {
            open.make_room(|other| other.peer() == peer, now)?;
        } else if open.connections.len() >= self.most {
            open.make_room(|_| true, now)?;
        }
        let number = open.next;
        open.next += 1;
        open.connections.insert(number, connection.clone());
        self.count.inc();
        Some(Entry { number, registry: self.clone() })
    }

    /// Closes the connections that have not asked for anything: the end does not wait for them.
    pub(super) fn close_silent(&self) {
        let open = self.lock();
        let silent = open.connections.values().filter(|connection| !connection.was_requested());
        silent.for_each(|connection| connection.0.close.notify_one());
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Open> {
        // A map that is still a map, whoever panicked.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Open {
    /// Closes the longest idle of some connections.
    fn make_room(&mut self, among: impl Fn(&ConnectionUse) -> bool, now: Instant) -> Option<()> {
        let longest = |least: Duration, of: fn(&ConnectionUse, Instant) -> Option<Duration>| {
            let some = self.connections.iter().filter(|(_, open)| among(open));
            let idle = some.filter_map(|(number, open)| Some((of(open, now)?, *number)));
            idle.filter(|(idle, _)| *idle >= least).max().map(|(_, number)| number)
        };
        let goes = longest(RECENT, ConnectionUse::idle)
            .or_else(|| longest(ABANDONED, |open, now| Some(open.untouched(now))))?;
        self.connections.remove(&goes)?.0.close.notify_one();
        Some(())
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        self.registry.count.dec();
        self.registry.lock().connections.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::IpAddr;

    fn peer(number: u8) -> Peer {
        Peer::at(IpAddr::from([10, 0, 0, number]))
    }

    /// Catches: connections that once asked and are held for ever keep everybody out.
    #[tokio::test]
    async fn the_longest_idle_one_makes_room_and_a_busy_one_does_not() {
        let (registry, start) = (Registry::new(4, 1.0), Instant::now());
        let enter = |number: u8, after_s: u64| {
            let connection = ConnectionUse::new(peer(number), start);
            registry.enter(&connection, start + Duration::from_secs(after_s)).map(|entry| (connection, entry))
        };
        let kept: Vec<_> = (0..4).map(|number| enter(number, 0).unwrap()).collect();
        assert!(enter(9, 0).is_none(), "they have just come");
        let _busy: Vec<_> = kept[..3].iter().map(|(connection, _)| connection.begin()).collect();
        let fifth = enter(9, 2).unwrap();
        let closed = tokio::time::timeout(Duration::from_secs(5), kept[3].0.closing()).await;
        assert!(closed.is_ok(), "the idle one is told");
        let _calls = fifth.0.begin();
        assert!(enter(10, 2).is_none(), "none is idle");
        assert!(enter(10, 90).is_some(), "calls of whom nothing was heard for long");
    }

    /// Catches: one address that has all connections.
    #[test]
    fn a_peer_that_has_its_share_makes_room_for_itself_only() {
        let (registry, start) = (Registry::new(4, 0.5), Instant::now());
        let later = start + Duration::from_secs(5);
        let enter = |number: u8| registry.enter(&ConnectionUse::new(peer(number), start), later);
        let greedy: Vec<_> = (0..9).filter_map(|_| enter(1)).collect();
        assert_eq!(greedy.len(), 9);
        assert_eq!(registry.lock().connections.len(), 2);
        let others = [enter(2).unwrap(), enter(2).unwrap()];
        drop(greedy);
        assert_eq!(registry.lock().connections.len(), 2, "entries of those that had to go are gone");
        drop(others);
        assert!(registry.lock().connections.is_empty());
    }
}
