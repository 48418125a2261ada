//! How often a caller may ask. Each has a rate of its own, so that one that asks without end keeps nobody else from it.

use std::num::NonZeroU32;
use std::time::Duration;

use governor::clock::{Clock, DefaultClock};
use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter};
use serde::{Deserialize, Serialize};

use super::caller::{Caller, Known};
use crate::shares;

/// Keys that are remembered before those are forgotten that have not asked for a while.
const MANY: usize = 4096;

/// How often one caller may ask; 0 is no limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RatesConfig {
    /// Localization requests of a caller, a second.
    pub localize_per_s: u32,
    /// Uploads of a caller, a minute; of a contributor that somebody vouches for, as many.
    pub upload_per_min: u32,
}

/// What is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rated {
    /// A localization request.
    Localize,
    /// An upload.
    Upload,
}

/// Counts what each caller asks.
pub struct Rates {
    clock: DefaultClock,
    localize: Option<DefaultKeyedRateLimiter<String>>,
    upload: Option<DefaultKeyedRateLimiter<String>>,
}

impl Rates {
    /// As configured.
    #[must_use]
    pub fn of(config: &RatesConfig) -> Self {
        // Whoever was silent may ask for some seconds' worth at once.
        let keyed = |quota: Option<Quota>| quota.map(RateLimiter::keyed);
        let burst = |rate: u32, times: u32| NonZeroU32::new(rate.saturating_mul(times));
        let localize = NonZeroU32::new(config.localize_per_s)
            .zip(burst(config.localize_per_s, 4))
            .map(|(rate, burst)| Quota::per_second(rate).allow_burst(burst));
        let upload = NonZeroU32::new(config.upload_per_min).map(Quota::per_minute);
        Self { clock: DefaultClock::default(), localize: keyed(localize), upload: keyed(upload) }
    }

    /// Counts one for a caller.
    ///
    /// # Errors
    /// When to come again, if it was too many.
    pub fn count(&self, what: Rated, caller: &Caller) -> Result<(), Duration> {
        match (caller.known, caller.address) {
            (Known::Unasked, _) | (Known::Anonymous, None) => Ok(()),
            (Known::Anonymous, Some(address)) => {
                self.count_for(what, &format!("?{}", shares::Peer::at(address)))
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
        };
        let Some(limiter) = limiter else { return Ok(()) };
        if limiter.len() > MANY {
            limiter.retain_recent();
        }
        limiter.check_key(&name.to_owned()).map_err(|not_until| not_until.wait_time_from(self.clock.now()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::Role;

    /// Catches: a caller that keeps others out, and a limit that is none.
    #[test]
    fn each_caller_has_a_rate_of_its_own() {
        let rates = Rates::of(&RatesConfig { localize_per_s: 1, upload_per_min: 2 });
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
}
