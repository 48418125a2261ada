//! Does an upload agree with the map that exists, and how far off is it?
//!
//! 1. [`part`]: the upload is cut into parts the size of a batch, and each is placed on the map.
//! 2. [`vet()`](Vetter::vet): the parts together say whether the upload agrees, and by which [`Offsets`] it lies
//!    beside the map.
//! 3. [`moved()`]: what agrees is moved onto the map before it is folded: the map stays sharp, however
//!    differently its contributors err.
//! 4. [`crate::datum`]: what everybody was moved by is summed up tile by tile. Its mean is what the crowd says the
//!    map's own georeference errs by, and is taken back from every answer.
//! 5. [`alarm`]: quarantined uploads of several contributors that agree with each other tell of a map
//!    that is wrong, or of a place that has changed.

pub mod alarm;
mod judge;
mod moved;
mod offset;
pub mod part;

use std::sync::Arc;

use crate::align::weights::TileWeights;
use crate::datum::Datum;
use crate::evidence::CellHits;
use crate::geo::TileId;
use crate::tile::{Ledger, Tile};

pub use judge::{Limits, Probed, Reason, Vetted, Vetter, Voice};
pub use moved::{moved, moved_shares};
pub use offset::Offsets;

/// An upload's cells in one tile, in order of their index.
pub type Share<'a> = (TileId, &'a [CellHits]);

/// The map that exists: what of it an upload is held against.
pub trait MapSide {
    /// A tile, prepared; `None` where the map has nothing, or nothing but what the upload's own contributor
    /// told: who is held against himself is moved onto his own last upload's errors, and the map's frame walks off
    /// from upload to upload (by half a metre in a town that one vehicle drove through).
    fn weights(&self, id: TileId) -> Option<Arc<TileWeights>>;

    /// What the tile's contributors were moved by; empty where the map has nothing.
    fn datum(&self, id: TileId) -> Datum;
}

/// Did anybody but this contributor tell something of a tile? Passes that its ledger has forgotten are taken
/// for others'.
#[must_use]
pub fn told_by_others(tile: &Tile, ledger: &Ledger, contributor: u64) -> bool {
    let own = ledger.passes().filter(|pass| pass.contributor == contributor).count();
    !tile.is_empty() && tile.datum().passes as usize > own
}
