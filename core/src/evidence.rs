//! What a map cell knows, and what an upload adds to it.
//!
//! - [`Cell`]: hits, who hit it and when, and how present it is.
//! - [`EvidenceDelta`]: an upload's hits and what it had in view, by tile ([`TileEvidence`]). [`mod@build`] makes it
//!   of scans and poses, with an [`EvidenceAccumulator`]; its bytes are in [`codec`].
//! - [`ViewBlocks`]: what was in view. [`presence`]: what that makes of a cell.
//! - [`InverseSensorModel`]: the paper's.

mod accumulator;
mod blocks;
pub mod build;
pub mod codec;
pub mod presence;
mod sensor_model;
mod view;

use std::collections::BTreeMap;

pub use accumulator::EvidenceAccumulator;
pub use blocks::{
    SUPPORT_BLOCK_CELLS, SUPPORT_BLOCKS, VIEW_BLOCK_CELLS, VIEW_BLOCK_M, VIEW_BLOCKS, ViewBlocks,
    support_block, view_block,
};
pub use sensor_model::InverseSensorModel;

use crate::geo::TileId;

/// Sub-cell steps along a cell's side: offsets are resolved to 10 cm / 256.
pub const OFFSET_STEPS: u32 = 256;
/// Steps that vehicles send of them: see "Upload size" in `docs/benchmarks/crowd.md` for what more are worth.
pub const SENT_STEPS: u32 = 1;

/// What a map cell knows. All but its presence is commutative: the same uploads give the same
/// in whatever order they come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Cell {
    /// Detections in the cell.
    pub hits: u32,
    /// Passes that hit it: one contributor on one day counts once, however often it hit.
    pub passes: u32,
    /// Distinct contributors that hit it, 255 for all above: one that comes again on another day counts
    /// once as long as its earlier pass is remembered (see [`crate::tile::Ledger`]).
    pub contributors: u8,
    /// Fraction of the passes with the cell in view that hit it, lately; [`presence::ALWAYS`] for all
    /// of them.
    pub presence: u16,
    /// First UTC day it was hit, counted from the Unix epoch.
    pub first_day: u16,
    /// Last UTC day it was hit.
    pub last_day: u16,
    /// Sum over the hits of the offset from the cell's corner, [`OFFSET_STEPS`] to a side (x, y).
    pub offset_sum: [u32; 2],
}

impl Cell {
    /// Mean position of the hits within the cell, 0 to 1 along each side.
    #[must_use]
    pub fn centroid(&self) -> [f64; 2] {
        centroid(self.hits, self.offset_sum)
    }

    /// Hits that a pass with the cell in view makes, on average: what the cell weighs. With one pass,
    /// its hits.
    #[must_use]
    pub fn mass(&self) -> f64 {
        f64::from(self.hits) / f64::from(self.passes.max(1)) * presence::fraction(self.presence)
    }
}

fn centroid(hits: u32, offset_sum: [u32; 2]) -> [f64; 2] {
    let mean = |sum: u32| (f64::from(sum) / f64::from(hits.max(1)) + 0.5) / f64::from(OFFSET_STEPS);
    offset_sum.map(mean)
}

/// One contributor on one day. The contributor is a keyed hash; the key stays with the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pass {
    /// UTC day, counted from the Unix epoch.
    pub day: u16,
    /// Keyed hash of the contributor's pseudonym.
    pub contributor: u64,
}

/// An upload's hits in one cell of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellHits {
    /// Row-major index in the tile: y * 512 + x, from the south-west corner.
    pub index: u32,
    /// Detections.
    pub hits: u32,
    /// Sum of their offsets, see [`Cell::offset_sum`].
    pub offset_sum: [u32; 2],
}

impl CellHits {
    /// Mean position of the hits within the cell, 0 to 1 along each side.
    #[must_use]
    pub fn centroid(&self) -> [f64; 2] {
        centroid(self.hits, self.offset_sum)
    }
}

/// The part of an evidence delta that lies in one tile.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TileEvidence {
    /// Cells that were hit, in order of their index.
    pub cells: Vec<CellHits>,
    /// Blocks that were in view. Those with a hit always count as such.
    pub observed: ViewBlocks,
}

impl TileEvidence {
    /// Hits, and nothing in view beyond their blocks. The cells must be in order of their index.
    #[must_use]
    pub fn of_hits(cells: Vec<CellHits>) -> Self {
        let observed = cells.iter().map(|cell| view_block(cell.index)).collect();
        Self { cells, observed }
    }

    /// Detections in the tile.
    #[must_use]
    pub fn detections(&self) -> u64 {
        self.cells.iter().map(|cell| u64::from(cell.hits)).sum()
    }
}

/// What one upload adds to the map.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct EvidenceDelta {
    /// Evidence by tile. A tile in which nothing was hit has none, though it may have been in view.
    pub tiles: BTreeMap<TileId, TileEvidence>,
    /// Detections that count, in the zone the positions belong to.
    pub detections: u64,
}
