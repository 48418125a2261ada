//! How often a caller may ask. Each has a rate of its own, so that one that asks without end keeps nobody else from it.

use std::hash::Hash;
use std::num::NonZeroU32;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use governor::clock::{Clock, DefaultClock};
use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter};
use serde::{Deserialize, Serialize};

use super::caller::{Caller, Known};
use crate::shares;

/// Keys that are remembered before those are forgotten that have not asked for a while.
const MANY: usize = 4096;
/// ... and how often all of them are looked at, at most.
const LOOKS_EVERY: Duration = Duration::from_secs(1);

/// How often one caller may ask; 0 is no limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RatesConfig {
    /// Localization requests of a caller, a second.
    pub localize_per_s: u32,
    /// Uploads of a caller, a minute; of a contributor that somebody vouches for, as many.
    pub upload_per_min: u32,
    /// Requests of a caller to the operators' port, a second.
    pub http_per_s: u32,
    /// Requests of an address to the operators' port, whoever asks, a second.
    pub http_address_per_s: u32,
}

/// What is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rated {
    /// A localization request.
    Localize,
    /// An upload.
    Upload,
    /// A request to the operators' port.
    Http,
}

/// Counts what each caller asks.
pub struct Rates {
    clock: DefaultClock,
    localize: Option<Limiter<String>>,
    upload: Option<Limiter<String>>,
    http: Option<Limiter<String>>,
    http_address: Option<Limiter<shares::Peer>>,
}

/// Counts by keys, and forgets those that have not asked for a while.
struct Limiter<K: Clone + Eq + Hash> {
    keyed: DefaultKeyedRateLimiter<K>,
    looked: Mutex<Instant>,
}

impl<K: Clone + Eq + Hash> Limiter<K> {
    fn of(quota: Quota) -> Self {
        Self { keyed: RateLimiter::keyed(quota), looked: Mutex::new(Instant::now()) }
    }

    fn count(&self, key: &K, clock: &DefaultClock) -> Result<(), Duration> {
        if self.keyed.len() > MANY {
            self.forget();
        }
        self.keyed.check_key(key).map_err(|not_until| not_until.wait_time_from(clock.now()))
    }

    /// Looks through all keys, which takes its time: not at each request of whoever has many addresses.
    fn forget(&self) {
        let Ok(mut looked) = self.looked.try_lock() else { return };
        if looked.elapsed() >= LOOKS_EVERY {
            self.keyed.retain_recent();
            *looked = Instant::now();
        }
    }
}

impl Rates {
    /// As configured.
    #[must_use]
    pub fn of(config: &RatesConfig) -> Self {
        // Whoever was silent may ask for some seconds' worth at once.
        let per_second = |rate: u32| {
            let burst = NonZeroU32::new(rate.saturating_mul(4));
            NonZeroU32::new(rate).zip(burst).map(|(rate, burst)| Quota::per_second(rate).allow_burst(burst))
        };
        Self {
            clock: DefaultClock::default(),
            localize: per_second(config.localize_per_s).map(Limiter::of),
            upload: NonZeroU32::new(config.upload_per_min).map(Quota::per_minute).map(Limiter::of),
            http: per_second(config.http_per_s).map(Limiter::of),
            http_address: per_second(config.http_address_per_s).map(Limiter::of),
        }
    }

    /// Counts one for a caller.
    ///
    /// # Errors
    /// When to come again, if it was too many.
    pub fn count(&self, what: Rated, caller: &Caller) -> Result<(), Duration> {
        match (caller.known, caller.address) {
            (Known::Unasked, _) | (Known::Anonymous, None) => Ok(()),
            (Known::Anonymous, Some(address)) => {
                self.count_for(what, &format!("?{}", shares::Peer::at(address.ip())))
            }
            _ => self.count_for(what, &caller.name),
        }
    }

    /// Counts one for a name.
    ///
    /// # Errors
    /// When to come again, if it was too many.
    pub fn count_for(&self, what: Rated, name: &str) -> Result<(), Duration> {
        let limiter = match what {
            Rated::Localize => &self.localize,
            Rated::Upload => &self.upload,
            Rated::Http => &self.http,
        };
        limiter.as_ref().map_or(Ok(()), |limiter| limiter.count(&name.to_owned(), &self.clock))
    }

    /// Counts a request to the operators' port for the address it comes from, before it is known who asks.
    ///
    /// # Errors
    /// When to come again, if it was too many.
    pub fn count_address(&self, address: shares::Peer) -> Result<(), Duration> {
        self.http_address.as_ref().map_or(Ok(()), |limiter| limiter.count(&address, &self.clock))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::Role;
    use crate::listen::RemoteAddress;

    /// Catches: a caller that keeps others out, and a limit that is none.
    #[test]
    fn each_caller_has_a_rate_of_its_own() {
        let rates =
            Rates::of(&RatesConfig { localize_per_s: 1, upload_per_min: 2, ..RatesConfig::default() });
        let caller = |name: &str| Caller {
            name: name.to_owned(),
            roles: Role::Mapper.into(),
            known: Known::Token,
            address: None,
            lease: None,
        };
        let taken =
            |what, name: &str| (0..50).take_while(|_| rates.count(what, &caller(name)).is_ok()).count();
        assert_eq!(taken(Rated::Upload, "car-7"), 2);
        assert!((4..7).contains(&taken(Rated::Localize, "car-7")));
        let wait = rates.count(Rated::Upload, &caller("car-7")).unwrap_err();
        assert!(wait > Duration::from_secs(1) && wait <= Duration::from_secs(30), "{wait:?}");
        assert_eq!(taken(Rated::Upload, "car-8"), 2);
        let none = Rates::of(&RatesConfig::default());
        assert!((0..1000).all(|_| none.count(Rated::Upload, &caller("car-7")).is_ok()));
        assert!((0..50).all(|_| rates.count(Rated::Upload, &Caller::unasked()).is_ok()));
    }

    /// Catches: a caller that asks without end from many addresses, and an address that does under many names.
    #[test]
    fn requests_count_for_the_caller_and_for_the_address() {
        let config = RatesConfig { http_per_s: 1, http_address_per_s: 2, ..RatesConfig::default() };
        let rates = Rates::of(&config);
        let at = |last: u8| shares::Peer::at([10, 0, 0, last].into());
        let caller = |last: u8| Caller {
            name: "alice".to_owned(),
            roles: Role::Viewer.into(),
            known: Known::Token,
            address: Some(RemoteAddress::Ip([10, 0, 0, last].into())),
            lease: None,
        };
        let taken = (0..50).take_while(|n| rates.count(Rated::Http, &caller(*n)).is_ok()).count();
        assert!((4..7).contains(&taken), "{taken}");
        let taken = (0..50).take_while(|_| rates.count_address(at(1)).is_ok()).count();
        assert!((8..12).contains(&taken), "{taken}");
        assert_eq!(rates.count_address(at(2)), Ok(()));
    }
}
