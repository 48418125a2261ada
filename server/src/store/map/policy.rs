//! Which evidence counts, and what of it is published.
//!
//! - `encoding`: the bytes by which policies are distinguished, under tags that never change.
//! - `legacy`: how they were distinguished before there were tags.

mod encoding;
mod legacy;

use std::hash::Hasher;

use echofix_core::tile::{Decay, Tile};
use echofix_core::vetting::VettingLimits;
use siphasher::sip::SipHasher24;

use super::write_buffer::Folded;
use crate::store::api::InspectedTile;

/// To be raised with every change of what folding makes of the same journal under the same policy, be it by a byte of the
/// weights that uploads are compared with: maps are then folded anew, under a new lineage. A test in `tests/folding.rs` fails then.
pub(in crate::store) const FOLDING: u32 = 1;

/// Which evidence counts, and what of it is published.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Policy {
    /// Distinct contributors that must have seen something near a cell for it to be published.
    pub publish_contributors: u8,
    /// Decay: how unconfirmed evidence loses its worth; without, it does not. Days are counted back from
    /// the newest day of the map: it needs no clock, and maps of recorded drives do not fade.
    pub decay: Option<Decay>,
    /// How far an upload may be off the map that exists; without, everything counts.
    pub vetting: Option<VettingLimits>,
}

impl Policy {
    /// Everything counts and is published: for a fleet that is trusted.
    #[must_use]
    pub fn trusting() -> Self {
        Self { publish_contributors: 1, decay: None, vetting: None }
    }

    /// Distinguishes policies and ways to fold: a generation of tiles made under another digest is not used. It is stored in
    /// the manifest, so it rests on tags and bits only, see [`encoding`].
    pub(in crate::store) fn digest(&self) -> u64 {
        siphash(encoding::encode(self, FOLDING).as_bytes())
    }

    /// The digest that manifests of the third format hold.
    pub(super) fn legacy_digest(&self) -> u64 {
        siphash(legacy::text(self, FOLDING).as_bytes())
    }

    /// The tile as it is published on a map whose newest day is `today`.
    pub(in crate::store) fn served(&self, tile: Tile, today: u16) -> Tile {
        match self.decay {
            None if self.publish_contributors <= 1 => tile,
            None => tile.published(self.publish_contributors, None, &Decay::default()),
            Some(decay) => tile.published(self.publish_contributors, Some(today), &decay),
        }
    }
}

impl Policy {
    /// All that is known of a tile, on a map whose newest day is `today`.
    pub(in crate::store) fn inspected(&self, folded: Folded, today: u16) -> InspectedTile {
        let Folded { version, tile, ledger } = folded;
        let (needed, today) = (self.publish_contributors, self.decay.map(|_| today));
        InspectedTile { version, tile, ledger, needed, today, decay: self.decay.unwrap_or_default() }
    }
}

/// SipHash-2-4 under the zero key.
fn siphash(bytes: &[u8]) -> u64 {
    let mut hasher = SipHasher24::new();
    hasher.write(bytes);
    hasher.finish()
}

#[cfg(test)]
mod tests;
