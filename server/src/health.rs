//! Is the service alive, is it ready, and if not, why.

use tokio::sync::watch;

/// May the service be sent requests?
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Readiness {
    /// Yes.
    Ready,
    /// Not now, for this reason.
    NotReady(String),
}

/// The service's readiness, set by what knows it and followed by what answers probes.
pub struct Health {
    state: watch::Sender<Readiness>,
}

impl Default for Health {
    fn default() -> Self {
        Self { state: watch::Sender::new(Readiness::NotReady("starting".to_owned())) }
    }
}

impl Health {
    /// Requests are welcome.
    pub fn ready(&self) {
        self.state.send_replace(Readiness::Ready);
    }

    /// Requests are not welcome, for this reason.
    pub fn not_ready(&self, reason: impl Into<String>) {
        self.state.send_replace(Readiness::NotReady(reason.into()));
    }

    /// The state now.
    #[must_use]
    pub fn get(&self) -> Readiness {
        self.state.borrow().clone()
    }

    /// Follows the state.
    #[must_use]
    pub fn follow(&self) -> watch::Receiver<Readiness> {
        self.state.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_service_is_not_ready_until_it_says_so() {
        let health = Health::default();
        assert_eq!(health.get(), Readiness::NotReady("starting".to_owned()));
        let follower = health.follow();
        health.ready();
        assert_eq!(*follower.borrow(), Readiness::Ready);
        health.not_ready("draining");
        assert_eq!(health.get(), Readiness::NotReady("draining".to_owned()));
    }
}
