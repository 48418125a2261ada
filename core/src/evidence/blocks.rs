//! Blocks of cells: coarser than a cell, finer than a tile.

use crate::geo::{CELL_M, CELLS_PER_TILE};

/// Cells along the side of a view block: 1.6 m, about as fine as what was in view can be known.
pub const VIEW_BLOCK_CELLS: usize = 16;
/// View blocks along a tile's side.
pub const VIEW_BLOCKS_PER_SIDE: usize = CELLS_PER_TILE / VIEW_BLOCK_CELLS;
/// View blocks of a tile.
pub const VIEW_BLOCKS: usize = VIEW_BLOCKS_PER_SIDE * VIEW_BLOCKS_PER_SIDE;
/// Side of a view block, metres.
pub const VIEW_BLOCK_M: f64 = VIEW_BLOCK_CELLS as f64 * CELL_M;

/// Cells along the side of a support block: 0.4 m. Uploads are moved onto the map before they are folded, so that
/// contributors who saw the same thing support the same block; in wider ones strangers' clutter meets.
pub const SUPPORT_BLOCK_CELLS: usize = 4;
/// Support blocks of a tile.
pub const SUPPORT_BLOCKS: usize = (CELLS_PER_TILE / SUPPORT_BLOCK_CELLS).pow(2);

/// Row-major number in the tile of the view block that holds a cell, given by its index.
#[must_use]
pub fn view_block(cell: u32) -> usize {
    block::<VIEW_BLOCK_CELLS>(cell)
}

/// Row-major number in the tile of the support block that holds a cell, given by its index.
#[must_use]
pub fn support_block(cell: u32) -> usize {
    block::<SUPPORT_BLOCK_CELLS>(cell)
}

fn block<const SIDE: usize>(cell: u32) -> usize {
    let (x, y) = (cell as usize % CELLS_PER_TILE, cell as usize / CELLS_PER_TILE);
    y / SIDE * (CELLS_PER_TILE / SIDE) + x / SIDE
}

/// A set of a tile's view blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ViewBlocks {
    words: [u64; VIEW_BLOCKS / 64],
}

impl ViewBlocks {
    /// Adds a block; true when it was not there yet.
    ///
    /// # Panics
    /// When `block` is not below [`VIEW_BLOCKS`].
    pub fn insert(&mut self, block: usize) -> bool {
        let (word, bit) = (&mut self.words[block / 64], 1 << (block % 64));
        let new = *word & bit == 0;
        *word |= bit;
        new
    }

    /// Whether a block is in the set.
    #[must_use]
    pub fn contains(&self, block: usize) -> bool {
        self.words.get(block / 64).is_some_and(|word| word >> (block % 64) & 1 == 1)
    }

    /// The blocks of both.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        Self { words: std::array::from_fn(|i| self.words[i] | other.words[i]) }
    }

    /// The blocks that are not in `other`.
    #[must_use]
    pub fn without(&self, other: &Self) -> Self {
        Self { words: std::array::from_fn(|i| self.words[i] & !other.words[i]) }
    }

    /// The blocks, in increasing order.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        (0..VIEW_BLOCKS).filter(|block| self.contains(*block))
    }

    /// Number of blocks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.words.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// True without any block.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.words.iter().all(|word| *word == 0)
    }

    /// Lengths of the runs of blocks outside and inside the set, by turns, from the first block on;
    /// the last run is left out when it lies outside. Blocks in view lie together: runs are short
    /// to write.
    pub(crate) fn runs(&self) -> Vec<usize> {
        let (mut runs, mut inside, mut from) = (Vec::new(), false, 0);
        for block in 0..=VIEW_BLOCKS {
            if (block < VIEW_BLOCKS && self.contains(block)) != inside {
                runs.push(block - from);
                (inside, from) = (!inside, block);
            }
        }
        runs
    }

    /// The set of such runs; `None` when they reach beyond the tile.
    pub(crate) fn from_runs(runs: impl Iterator<Item = usize>) -> Option<Self> {
        let (mut blocks, mut from) = (Self::default(), 0_usize);
        for (number, run) in runs.enumerate() {
            let end = from.checked_add(run).filter(|end| *end <= VIEW_BLOCKS)?;
            if number % 2 == 1 {
                for block in from..end {
                    blocks.insert(block);
                }
            }
            from = end;
        }
        Some(blocks)
    }
}

impl FromIterator<usize> for ViewBlocks {
    fn from_iter<I: IntoIterator<Item = usize>>(blocks: I) -> Self {
        let mut set = Self::default();
        for block in blocks {
            set.insert(block);
        }
        set
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn a_set_of_blocks_is_a_set(
            a in prop::collection::btree_set(0..VIEW_BLOCKS, 0..60),
            b in prop::collection::btree_set(0..VIEW_BLOCKS, 0..60),
        ) {
            let set = |blocks: &BTreeSet<usize>| blocks.iter().copied().collect::<ViewBlocks>();
            let listed = |blocks: ViewBlocks| blocks.iter().collect::<BTreeSet<_>>();
            prop_assert_eq!(listed(set(&a)), a.clone());
            prop_assert_eq!((set(&a).len(), set(&a).is_empty()), (a.len(), a.is_empty()));
            prop_assert_eq!(listed(set(&a).union(&set(&b))), &a | &b);
            prop_assert_eq!(listed(set(&a).without(&set(&b))), &a - &b);
            prop_assert_eq!(ViewBlocks::from_runs(set(&a).runs().into_iter()), Some(set(&a)));
        }
    }

    #[test]
    fn runs_beyond_the_tile_are_refused() {
        let all: ViewBlocks = (0..VIEW_BLOCKS).collect();
        assert_eq!(all.runs(), [0, VIEW_BLOCKS]);
        assert_eq!(ViewBlocks::from_runs([0, VIEW_BLOCKS + 1].into_iter()), None);
        assert_eq!(ViewBlocks::from_runs([1, usize::MAX].into_iter()), None);
    }

    #[test]
    fn blocks_are_counted_row_by_row_from_the_south_west() {
        assert_eq!([view_block(0), view_block(15), view_block(16), view_block(16 * 512)], [0, 0, 1, 32]);
        assert_eq!(view_block(512 * 512 - 1), VIEW_BLOCKS - 1);
        assert_eq!([support_block(3), support_block(4), support_block(4 * 512 + 5)], [0, 1, 129]);
        assert_eq!(support_block(512 * 512 - 1), SUPPORT_BLOCKS - 1);
    }
}
