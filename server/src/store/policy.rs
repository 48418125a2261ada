//! What of the crowd's evidence counts, and what is served.

use echofix_core::tile::{Decay, Tile};
use echofix_core::vetting::Limits;

/// What of the crowd's evidence counts, and what is served.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Policy {
    /// Distinct contributors that must have seen something near a cell for it to be served.
    pub publish_contributors: u8,
    /// How evidence that nobody confirms loses its worth. Days are counted back from the newest day of
    /// the map: it needs no clock, and maps of recorded drives do not fade.
    pub decay: Decay,
    /// How far an upload may be off the map that exists; without, everything counts.
    pub vetting: Option<Limits>,
}

impl Policy {
    /// Everything counts and is served: for a fleet that is trusted.
    #[must_use]
    pub fn trusting() -> Self {
        Self { publish_contributors: 1, decay: Decay::default(), vetting: None }
    }

    /// The tile as it is served on a map whose newest day is `today`.
    pub(super) fn served(&self, tile: &Tile, today: u16) -> Tile {
        tile.published(self.publish_contributors, Some(today), &self.decay)
    }
}
