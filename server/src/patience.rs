//! How long a caller waits for work that cannot be dropped.
//!
//! Blocking work runs on when its call is gone: it must look by itself, between steps of some milliseconds, whether anybody
//! still waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a caller waits: as long as the call is there, until its deadline. The default waits for ever.
#[derive(Debug, Clone, Default)]
pub struct Patience {
    gone: Arc<AtomicBool>,
    deadline: Option<Instant>,
}

impl Patience {
    /// A caller that waits until its deadline, if it has one; and what it holds while it waits.
    #[must_use]
    pub fn until(deadline: Option<Instant>) -> (Self, Waiting) {
        let patience = Self { gone: Arc::default(), deadline };
        (patience.clone(), Waiting(patience))
    }

    /// Nobody waits any more: the caller is gone, or its deadline has passed.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.gone.load(Ordering::Relaxed) || self.deadline.is_some_and(|at| at <= Instant::now())
    }

    /// Whether the caller waits for that long, as far as is known.
    #[must_use]
    pub fn lasts(&self, time: Duration) -> bool {
        !self.is_over() && self.deadline.is_none_or(|at| at.saturating_duration_since(Instant::now()) >= time)
    }
}

/// A call that is there; nobody waits once it is dropped.
#[derive(Debug)]
pub struct Waiting(Patience);

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.gone.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_waits_after_the_call_or_the_deadline() {
        let (patience, waiting) = Patience::until(None);
        assert!(!patience.is_over() && patience.lasts(Duration::from_hours(1)));
        drop(waiting);
        assert!(patience.is_over() && !patience.lasts(Duration::ZERO));
        let (patience, _waiting) = Patience::until(Some(Instant::now() + Duration::from_mins(1)));
        assert!(!patience.is_over() && !patience.lasts(Duration::from_mins(2)));
        let (patience, _waiting) = Patience::until(Some(Instant::now()));
        assert!(patience.is_over());
        assert!(!Patience::default().is_over());
    }
}
