//! A tile pooled to 32 x 32 blocks, small enough to keep thousands of.

use echofix_core::tile::Tile;

use super::Spot;
use super::plane::TILE_SHIFT;

/// log2 of the cells along a block's side: 16 cells, 1.6 m.
pub const SHIFT: u32 = 4;
const BLOCKS: u32 = 1 << (TILE_SHIFT - SHIFT);

/// The occupied blocks of a tile.
pub struct TileSummary {
    blocks: Box<[(u16, Spot)]>,
}

impl TileSummary {
    /// Pools a tile.
    pub fn of(tile: &Tile) -> Self {
        let mut all = vec![Spot::NOTHING; (BLOCKS * BLOCKS) as usize];
        for (column, row, spot) in cells(tile) {
            all[((row >> SHIFT) * BLOCKS + (column >> SHIFT)) as usize].raise(spot);
        }
        let occupied = all.into_iter().enumerate().filter(|(_, spot)| spot.level > 0);
        Self { blocks: occupied.map(|(i, spot)| (i as u16, spot)).collect() }
    }

    /// Its blocks as (column, row, spot).
    pub fn blocks(&self) -> impl Iterator<Item = (u32, u32, Spot)> {
        self.blocks.iter().map(|&(i, spot)| (u32::from(i) % BLOCKS, u32::from(i) / BLOCKS, spot))
    }

    /// Bytes it takes.
    pub fn weight(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.blocks)
    }
}

/// A tile's cells as (column, row, spot).
pub fn cells(tile: &Tile) -> impl Iterator<Item = (u32, u32, Spot)> {
    let side = 1 << TILE_SHIFT;
    tile.cells().iter().map(move |(index, cell)| (index % side, index / side, Spot::of_cell(cell)))
}
