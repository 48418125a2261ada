//! What of the crowd's evidence counts, and what is served.

use std::hash::Hasher;

use echofix_core::tile::{Decay, Tile};
use echofix_core::vetting::Limits;
use siphasher::sip::SipHasher24;

/// Raised by whoever changes what folding makes of the same journal under the same policy, be it by a byte of the weights
/// that uploads are held against: maps are then folded anew, of another lineage. A test in `tests/folding.rs` tells when.
pub(super) const FOLDING: u32 = 1;

/// What of the crowd's evidence counts, and what is served.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Policy {
    /// Distinct contributors that must have seen something near a cell for it to be served.
    pub publish_contributors: u8,
    /// How evidence that nobody confirms loses its worth; without, it keeps it. Days are counted back from
    /// the newest day of the map: it needs no clock, and maps of recorded drives do not fade.
    pub decay: Option<Decay>,
    /// How far an upload may be off the map that exists; without, everything counts.
    pub vetting: Option<Limits>,
}

impl Policy {
    /// Everything counts and is served: for a fleet that is trusted.
    #[must_use]
    pub fn trusting() -> Self {
        Self { publish_contributors: 1, decay: None, vetting: None }
    }

    /// Tells policies apart, and what the code's own constants in them were: tiles of another one are not the same.
    pub(super) fn digest(&self) -> u64 {
        let mut hasher = SipHasher24::new();
        hasher.write(format!("{FOLDING} {self:?}").as_bytes());
        hasher.finish()
    }

    /// The tile as it is served on a map whose newest day is `today`.
    pub(super) fn served(&self, tile: Tile, today: u16) -> Tile {
        match self.decay {
            None if self.publish_contributors <= 1 => tile,
            None => tile.published(self.publish_contributors, None, &Decay::default()),
            Some(decay) => tile.published(self.publish_contributors, Some(today), &decay),
        }
    }
}
