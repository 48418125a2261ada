//! Is the service ready, for what, and if not, why.

use tokio::sync::watch;

/// May the service be sent requests of a kind?
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Readiness {
    /// Yes.
    Ready,
    /// Yes, but not all is well: what a person should know.
    Degraded(String),
    /// Not now, for this reason.
    NotReady(String),
}

impl Readiness {
    /// Are requests welcome?
    #[must_use]
    pub fn is_ready(&self) -> bool {
        !matches!(self, Self::NotReady(_))
    }

    /// What is not well.
    #[must_use]
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Ready => None,
            Self::Degraded(reason) | Self::NotReady(reason) => Some(reason),
        }
    }
}

/// The readiness of what the service does. One can go on without the other: a full disk takes no uploads, but the map on it
/// can be localized against.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServiceReadiness {
    /// To localize, and to serve tiles.
    pub localizing: Readiness,
    /// To take uploads.
    pub uploading: Readiness,
}

impl ServiceReadiness {
    /// The same of both.
    #[must_use]
    pub fn of_all(readiness: &Readiness) -> Self {
        Self { localizing: readiness.clone(), uploading: readiness.clone() }
    }
}

/// The service's readiness, set by what knows it and followed by what answers probes.
pub struct Health {
    state: watch::Sender<ServiceReadiness>,
}

impl Default for Health {
    fn default() -> Self {
        let starting = Readiness::NotReady("starting".to_owned());
        Self { state: watch::Sender::new(ServiceReadiness::of_all(&starting)) }
    }
}

impl Health {
    /// Replaces the state.
    pub fn set(&self, readiness: ServiceReadiness) {
        self.state.send_if_modified(|state| {
            let changed = *state != readiness;
            *state = readiness;
            changed
        });
    }

    /// Requests are welcome.
    pub fn ready(&self) {
        self.set(ServiceReadiness::of_all(&Readiness::Ready));
    }

    /// No requests are welcome, for this reason.
    pub fn not_ready(&self, reason: impl Into<String>) {
        self.set(ServiceReadiness::of_all(&Readiness::NotReady(reason.into())));
    }

    /// The state now.
    #[must_use]
    pub fn get(&self) -> ServiceReadiness {
        self.state.borrow().clone()
    }

    /// Follows the state.
    #[must_use]
    pub fn follow(&self) -> watch::Receiver<ServiceReadiness> {
        self.state.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_service_is_not_ready_until_it_says_so() {
        let health = Health::default();
        assert_eq!(health.get().localizing, Readiness::NotReady("starting".to_owned()));
        let follower = health.follow();
        health.ready();
        assert!(follower.borrow().localizing.is_ready() && follower.borrow().uploading.is_ready());
        health.not_ready("draining");
        assert_eq!(health.get().uploading.reason(), Some("draining"));
        let degraded = Readiness::Degraded("the disk is full".to_owned());
        assert!(degraded.is_ready() && degraded.reason().is_some());
    }
}
