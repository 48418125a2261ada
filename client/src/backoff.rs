//! How long to wait before asking again.

use std::time::Duration;

use rand::RngExt;

/// Exponential waiting times with jitter, so that a fleet does not come back all at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BackoffPolicy {
    /// Upper limit of the first wait.
    pub initial: Duration,
    /// Upper limit of every wait; a service's own request to wait longer is honoured beyond it.
    pub max: Duration,
}

impl Default for BackoffPolicy {
    /// From half a second to a minute.
    fn default() -> Self {
        Self { initial: Duration::from_millis(500), max: Duration::from_mins(1) }
    }
}

/// A service is not waited for longer than this, whatever it asks: it may have been restarted.
const MAX_PUSHBACK: Duration = Duration::from_hours(1);

/// The state of one series of attempts.
#[derive(Debug, Clone)]
pub(crate) struct Backoff {
    policy: BackoffPolicy,
    failures: u32,
}

impl Backoff {
    pub(crate) fn new(policy: BackoffPolicy) -> Self {
        Self { policy, failures: 0 }
    }

    /// An attempt succeeded: the next failure starts from the initial wait again.
    pub(crate) fn reset(&mut self) {
        self.failures = 0;
    }

    /// The wait after one more failure: between half the limit and the limit, which doubles each
    /// time. What the service asked for (`retry_after`) comes on top.
    pub(crate) fn next(&mut self, retry_after: Option<Duration>) -> Duration {
        let doubled = self.policy.initial.saturating_mul(1_u32 << self.failures.min(16));
        let limit = doubled.min(self.policy.max).max(Duration::from_millis(1));
        self.failures = self.failures.saturating_add(1);
        retry_after.unwrap_or_default().min(MAX_PUSHBACK) + rand::rng().random_range(limit / 2..=limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POLICY: BackoffPolicy =
        BackoffPolicy { initial: Duration::from_millis(100), max: Duration::from_secs(1) };

    #[test]
    fn waits_double_up_to_the_limit_and_start_over() {
        let mut backoff = Backoff::new(POLICY);
        for limit_ms in [100, 200, 400, 800, 1000, 1000, 1000] {
            let wait = backoff.next(None);
            assert!(wait <= Duration::from_millis(limit_ms) && wait >= Duration::from_millis(limit_ms / 2));
        }
        backoff.reset();
        assert!(backoff.next(None) <= Duration::from_millis(100));
    }

    #[test]
    fn the_service_is_waited_for_and_vehicles_spread() {
        let asked = Duration::from_secs(5);
        let waits: Vec<_> = (0..50).map(|_| Backoff::new(POLICY).next(Some(asked))).collect();
        assert!(waits.iter().all(|w| *w >= asked));
        assert!(waits.iter().any(|w| *w != waits[0]), "no jitter");
    }

    #[test]
    fn endless_failures_do_not_overflow() {
        let mut backoff = Backoff::new(BackoffPolicy { initial: Duration::MAX, max: Duration::from_secs(1) });
        for _ in 0..100 {
            assert!(backoff.next(None) <= Duration::from_secs(1));
        }
    }
}
