//! A tile: 512 x 512 cells of 10 cm, sparse, and the ledger of who voted lately.
//!
//! A [`Tile`] is what is served. A [`Ledger`] stays with the service: it remembers which pass
//! voted for which cell while that pass may still grow, so that one contributor counts once a
//! day and cell, whatever the order and number of its uploads.

mod codec;
mod ledger;

pub use codec::{DecodeError, decode, decode_ledger, encode, encode_ledger};
pub use ledger::Ledger;

use crate::evidence::{Cell, CellHits, Pass};
use crate::geo::CELLS_PER_TILE;

/// Cells of a tile.
pub const CELLS: u32 = (CELLS_PER_TILE * CELLS_PER_TILE) as u32;

/// The evidence of one tile.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Tile {
    /// Occupied cells as (row-major index, cell), in order of the index.
    cells: Vec<(u32, Cell)>,
}

impl Tile {
    /// A tile from occupied cells in strictly increasing order of their index.
    ///
    /// Returns `None` when the order is wrong or an index lies outside the tile.
    #[must_use]
    pub fn from_cells(cells: Vec<(u32, Cell)>) -> Option<Self> {
        let ordered = cells.windows(2).all(|w| w[0].0 < w[1].0);
        let inside = cells.last().is_none_or(|(index, _)| *index < CELLS);
        (ordered && inside).then_some(Self { cells })
    }

    /// Occupied cells as (row-major index: y * 512 + x, cell), in order of the index.
    #[must_use]
    pub fn cells(&self) -> &[(u32, Cell)] {
        &self.cells
    }

    /// Number of occupied cells.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// True when nothing was ever seen here.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// The last UTC day anything was seen, counted from the Unix epoch; 0 when nothing was.
    #[must_use]
    pub fn newest_day(&self) -> u16 {
        self.cells.iter().map(|(_, cell)| cell.last_day).max().unwrap_or(0)
    }

    /// Folds one upload's hits in, as a vote of `pass`; `ledger` is the tile's own.
    ///
    /// `hits` must be in order of their index, as [`crate::evidence::Contribution`] holds them.
    pub fn fold(&mut self, ledger: &mut Ledger, pass: Pass, hits: &[CellHits]) {
        let voters = ledger.vote(pass, hits.iter().map(|h| h.index));
        let mut merged = Vec::with_capacity(self.cells.len() + hits.len());
        let mut old = self.cells.iter().copied().peekable();
        for (hit, first_vote) in hits.iter().zip(voters) {
            while let Some(cell) = old.next_if(|(index, _)| *index < hit.index) {
                merged.push(cell);
            }
            let before = old.next_if(|(index, _)| *index == hit.index).map(|(_, cell)| cell);
            merged.push((hit.index, raised(before, pass.day, hit, first_vote)));
        }
        merged.extend(old);
        self.cells = merged;
    }
}

/// The cell after a hit; `first_vote` says whether the pass had not voted for it yet.
fn raised(before: Option<Cell>, day: u16, hit: &CellHits, first_vote: bool) -> Cell {
    let before = before.unwrap_or(Cell { first_day: day, last_day: day, ..Cell::default() });
    Cell {
        hits: before.hits.saturating_add(hit.hits),
        passes: before.passes + u32::from(first_vote),
        first_day: before.first_day.min(day),
        last_day: before.last_day.max(day),
        offset_sum: [0, 1].map(|axis| before.offset_sum[axis].saturating_add(hit.offset_sum[axis])),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Hits as (index, count), made into what a contribution holds.
    pub(crate) fn hits(cells: &std::collections::BTreeMap<u32, u32>) -> Vec<CellHits> {
        cells
            .iter()
            .map(|(index, hits)| CellHits { index: *index, hits: *hits, offset_sum: [hits * 10, hits * 200] })
            .collect()
    }

    pub(crate) fn uploads() -> impl Strategy<Value = Vec<(Pass, Vec<CellHits>)>> {
        let pass = (20_000..20_003_u16, 0..3_u64).prop_map(|(day, contributor)| Pass { day, contributor });
        let cells = prop::collection::btree_map(0..40_u32, 1..5_u32, 0..12).prop_map(|c| hits(&c));
        prop::collection::vec((pass, cells), 1..10)
    }

    fn folded(uploads: &[(Pass, Vec<CellHits>)]) -> (Tile, Ledger) {
        let (mut tile, mut ledger) = (Tile::default(), Ledger::default());
        for (pass, hits) in uploads {
            tile.fold(&mut ledger, *pass, hits);
        }
        (tile, ledger)
    }

    proptest! {
        #[test]
        fn the_order_of_uploads_does_not_matter(mut uploads in uploads()) {
            let forward = folded(&uploads);
            uploads.reverse();
            prop_assert_eq!(forward, folded(&uploads));
        }

        #[test]
        fn passes_are_distinct_contributor_days(uploads in uploads()) {
            let (tile, _) = folded(&uploads);
            for (index, cell) in tile.cells() {
                let hitters: std::collections::BTreeSet<_> =
                    uploads.iter().filter(|(_, h)| h.iter().any(|h| h.index == *index)).map(|(p, _)| *p).collect();
                prop_assert_eq!(cell.passes as usize, hitters.len());
                let days = || hitters.iter().map(|p| p.day);
                prop_assert_eq!(Some(cell.first_day), days().min());
                prop_assert_eq!(Some(cell.last_day), days().max());
            }
        }
    }

    #[test]
    fn cells_out_of_order_do_not_make_a_tile() {
        let cell = Cell::default();
        assert!(Tile::from_cells(vec![(1, cell), (1, cell)]).is_none());
        assert!(Tile::from_cells(vec![(CELLS, cell)]).is_none());
        assert!(Tile::from_cells(vec![(0, cell), (CELLS - 1, cell)]).is_some());
    }
}
