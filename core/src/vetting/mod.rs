//! Does an upload agree with the map that exists, and how far off is it?
//!
//! 1. [`part`]: the upload is cut into parts the size of a batch; [`matching`]: each is matched with the map.
//! 2. [`vet()`](Vetter::vet): the parts together say whether the upload agrees, and by which [`Offsets`] it lies
//!    beside the map.
//! 3. [`moved()`]: what agrees is moved onto the map before it is folded: the map stays sharp, however
//!    differently its contributors err.
//! 4. [`crate::datum`]: the offsets of all contributors are summed up tile by tile. Their mean is the map's own
//!    offset, and is taken back from every answer.
//! 5. [`alarm`]: quarantined uploads of several contributors that agree with each other show that the map
//!    is wrong, or that a street has changed.

pub mod alarm;
mod judge;
pub mod matching;
mod moved;
mod offset;
pub mod part;

use std::sync::Arc;

use crate::align::weights::TileWeights;
use crate::datum::Datum;
use crate::evidence::CellHits;
use crate::geo::TileId;
use crate::tile::{Ledger, Tile};

pub use judge::{Excess, JudgedPart, PartVerdict, Reason, Vetted, Vetter, VettingLimits};
pub use moved::{moved, moved_evidence};
pub use offset::Offsets;

/// An upload's cells in one tile, in order of their index.
pub type TileHits<'a> = (TileId, &'a [CellHits]);

/// The part of the map that an upload is compared with.
pub trait MapSide {
    /// A tile, prepared; `None` where the map has nothing, or nothing but the upload's own contributor's evidence.
    /// Compared with that, an upload would be moved onto the errors of the last one, and the map would drift
    /// from upload to upload (by half a metre in a town that one vehicle drove through).
    fn weights(&self, id: TileId) -> Option<Arc<TileWeights>>;

    /// The offsets of the tile's contributors; empty where the map has nothing.
    fn datum(&self, id: TileId) -> Datum;
}

/// Does a tile hold evidence of anybody but this contributor? Passes that its ledger has forgotten count as
/// others'.
#[must_use]
pub fn has_other_contributors(tile: &Tile, ledger: &Ledger, contributor: u64) -> bool {
    let own = ledger.passes().filter(|pass| pass.contributor == contributor).count();
    !tile.is_empty() && tile.datum().passes as usize > own
}
