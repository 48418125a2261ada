//! A tile: 512 x 512 cells of 10 cm, sparse, and the ledger of who voted lately.
//!
//! A [`Tile`] is the evidence; what is served is [`Tile::published`]. A [`Ledger`] stays with the
//! service: it remembers which pass voted for which cell and had which blocks in view while that pass
//! may still grow, so that one contributor counts once a day and cell, whatever the order and number
//! of its uploads.

mod codec;
mod fold;
mod layer;
mod ledger;
mod merge;
mod published;
mod standing;
mod votes;

pub use codec::{DecodeError, decode, decode_ledger, encode, encode_ledger};
pub use layer::{Grain, decode_layer, encode_layer};
pub use ledger::Ledger;
pub use published::Decay;
pub use standing::Standing;

use crate::datum::Datum;
use crate::evidence::{Cell, SUPPORT_BLOCKS, VIEW_BLOCKS, support_block, view_block};
use crate::geo::CELLS_PER_TILE;

/// Cells of a tile.
pub const CELLS: u32 = (CELLS_PER_TILE * CELLS_PER_TILE) as u32;

/// The evidence of one tile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tile {
    /// Occupied cells as (row-major index, cell), in order of the index.
    cells: Vec<(u32, Cell)>,
    /// Passes that had each view block in view, 65535 for all above.
    observed: Box<[u16; VIEW_BLOCKS]>,
    /// Distinct contributors with a hit in each support block, 255 for all above; counted as
    /// [`Cell::contributors`] are. They stay when the cells fade.
    support: Box<[u8; SUPPORT_BLOCKS]>,
    /// By how much vetting moved the passes.
    datum: Datum,
}

impl Default for Tile {
    fn default() -> Self {
        Self {
            cells: Vec::new(),
            observed: Box::new([0; VIEW_BLOCKS]),
            support: Box::new([0; SUPPORT_BLOCKS]),
            datum: Datum::default(),
        }
    }
}

impl Tile {
    /// A tile from occupied cells in strictly increasing order of their index. Blocks are taken to
    /// have been in view, and to be supported, as often as the best of their cells says.
    ///
    /// Returns `None` when the order is wrong or an index lies outside the tile.
    #[must_use]
    pub fn from_cells(cells: Vec<(u32, Cell)>) -> Option<Self> {
        let ordered = cells.windows(2).all(|w| w[0].0 < w[1].0);
        let inside = cells.last().is_none_or(|(index, _)| *index < CELLS);
        if !(ordered && inside) {
            return None;
        }
        let mut tile = Self::default();
        for (index, cell) in &cells {
            let observed = &mut tile.observed[view_block(*index)];
            *observed = (*observed).max(u16::try_from(cell.passes).unwrap_or(u16::MAX));
            let support = &mut tile.support[support_block(*index)];
            *support = (*support).max(cell.contributors);
        }
        Some(Self { cells, ..tile })
    }

    /// Occupied cells as (row-major index: y * 512 + x, cell), in order of the index.
    #[must_use]
    pub fn cells(&self) -> &[(u32, Cell)] {
        &self.cells
    }

    /// Passes that had each view block in view, by the block's row-major number; 65535 for all above.
    #[must_use]
    pub fn observed(&self) -> &[u16; VIEW_BLOCKS] {
        &self.observed
    }

    /// Distinct contributors with a hit in each support block, by the block's row-major number; 255 for
    /// all above.
    #[must_use]
    pub fn support(&self) -> &[u8; SUPPORT_BLOCKS] {
        &self.support
    }

    /// By how much vetting moved the passes over it: how far the crowd says the tile's georeference errs.
    #[must_use]
    pub fn datum(&self) -> Datum {
        self.datum
    }

    /// Number of occupied cells.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// True when no cell is occupied.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Passes over the cell of a typical hit, 1 without hits: how many surveys the tile amounts to.
    #[must_use]
    pub fn mean_passes(&self) -> f64 {
        let sums = self.cells.iter().fold([0.0_f64; 2], |[weighted, all], (_, cell)| {
            let hits = f64::from(cell.hits);
            [weighted + hits * f64::from(cell.passes), all + hits]
        });
        if sums[1] > 0.0 { sums[0] / sums[1] } else { 1.0 }
    }

    /// The last UTC day anything was seen, counted from the Unix epoch; 0 when nothing was.
    #[must_use]
    pub fn newest_day(&self) -> u16 {
        self.cells.iter().map(|(_, cell)| cell.last_day).max().unwrap_or(0)
    }
}

#[cfg(test)]
pub(crate) mod tests;
