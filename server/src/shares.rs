//! Pools of which no peer can take all.

use std::collections::HashMap;
use std::convert::Infallible;
use std::fmt;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, PoisonError};

use axum::extract::FromRequestParts;
use axum::http::request::Parts;

/// Who takes from a pool: an address, or in IPv6 the network of 64 bits that one host has for itself. This is the one place
/// that says what a peer is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Peer(IpAddr);

impl Peer {
    /// A peer at an address.
    #[must_use]
    pub fn at(address: IpAddr) -> Self {
        Self(match address.to_canonical() {
            IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() & !u128::from(u64::MAX))),
            v4 @ IpAddr::V4(_) => v4,
        })
    }

    /// The one peer of calls that come by no connection.
    #[must_use]
    pub fn unknown() -> Self {
        Self(IpAddr::V6(Ipv6Addr::UNSPECIFIED))
    }
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// The peer whose connection a request came by.
impl<S: Sync> FromRequestParts<S> for Peer {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        Ok(parts.extensions.get().copied().unwrap_or_else(Self::unknown))
    }
}

/// Places, of which one peer may hold some.
#[derive(Debug)]
pub struct Pool {
    places: usize,
    each: usize,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    all: usize,
    by_peer: HashMap<Peer, usize>,
}

impl Pool {
    /// So many places, of which one peer may hold a share (0 to 1), one at least.
    #[must_use]
    pub fn new(places: usize, share: f64) -> Arc<Self> {
        let each = part(places, share);
        Arc::new(Self { places, each, held: Mutex::default() })
    }

    /// A place, if there is one for this peer.
    pub fn take(self: &Arc<Self>, peer: Peer) -> Option<Place> {
        let mut held = self.lock();
        let own = held.by_peer.get(&peer).copied().unwrap_or(0);
        if held.all >= self.places || own >= self.each {
            return None;
        }
        held.all += 1;
        held.by_peer.insert(peer, own + 1);
        Some(Place { pool: Arc::clone(self), peer })
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Held> {
        // Both counts change under one lock, and nothing between them panics.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// How many of so many places a share of them is: one at least.
pub(crate) fn part(places: usize, share: f64) -> usize {
    ((places as f64 * share).floor() as usize).clamp(1, places.max(1))
}

/// A place in a pool, given back when dropped.
#[derive(Debug)]
pub struct Place {
    pool: Arc<Pool>,
    peer: Peer,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut held = self.pool.lock();
        held.all -= 1;
        if let Some(own) = held.by_peer.get_mut(&self.peer) {
            *own -= 1;
            if *own == 0 {
                held.by_peer.remove(&self.peer);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn peer(number: u8) -> Peer {
        Peer::at(IpAddr::from([10, 0, 0, number]))
    }

    /// Catches: one peer that keeps all others out.
    #[test]
    fn nobody_takes_all_and_everything_comes_back() {
        let pool = Pool::new(16, 0.5);
        let greedy: Vec<_> = std::iter::from_fn(|| pool.take(peer(1))).collect();
        assert_eq!(greedy.len(), 8);
        let others: Vec<_> = std::iter::from_fn(|| pool.take(peer(2))).collect();
        assert_eq!((others.len(), pool.take(peer(3)).is_none()), (8, true));
        drop(greedy);
        assert!(pool.take(peer(3)).is_some());
        drop(others);
        assert!(pool.lock().by_peer.is_empty() && pool.lock().all == 0);
        assert!(Pool::new(1, 0.1).take(peer(1)).is_some());
        assert_eq!(std::iter::repeat_with(|| Pool::new(4, 1.0)).take(1).map(|p| p.each).sum::<usize>(), 4);
    }

    #[test]
    fn a_host_of_many_addresses_is_one_peer() {
        let at = |text: &str| Peer::at(text.parse().unwrap());
        assert_eq!(at("2001:db8::1"), at("2001:db8::ffff:1:2"));
        assert_ne!(at("2001:db8::1"), at("2001:db8:0:1::1"));
        assert_eq!(at("::ffff:10.0.0.1"), peer(1));
        assert_ne!(peer(1), peer(2));
    }

    proptest! {
        #[test]
        fn counts_never_go_wrong(takes in proptest::collection::vec((0_u8..4, 0_usize..9), 0..200)) {
            let pool = Pool::new(6, 0.5);
            let mut held: Vec<(u8, Place)> = Vec::new();
            for (number, drop_at) in takes {
                let own = held.iter().filter(|(holder, _)| *holder == number).count();
                let taken = pool.take(peer(number));
                prop_assert_eq!(taken.is_some(), own < 3 && held.len() < 6);
                held.extend(taken.map(|place| (number, place)));
                if drop_at < held.len() {
                    held.swap_remove(drop_at);
                }
            }
        }
    }
}
