//! A tile of another map joins one of ours.

use super::Tile;
use crate::evidence::{Cell, view_block};

impl Tile {
    /// Both tiles' evidence. Their passes and contributors are taken for others than ours, each map's
    /// presence counts for as many passes as had the block in view.
    #[must_use]
    pub fn merged(&self, theirs: &Self) -> Self {
        let observed = |tile: &Self, index: u32| tile.observed[view_block(index)];
        let join = |index: u32, ours: Option<&Cell>, others: Option<&Cell>| {
            let weights = [observed(self, index), observed(theirs, index)];
            joined(ours.copied().unwrap_or_default(), others.copied().unwrap_or_default(), weights)
        };
        let mut cells = Vec::with_capacity(self.len() + theirs.len());
        let mut other = theirs.cells.iter().peekable();
        for (index, cell) in &self.cells {
            while let Some((before, cell)) = other.next_if(|(their, _)| their < index) {
                cells.push((*before, join(*before, None, Some(cell))));
            }
            let same = other.next_if(|(their, _)| their == index).map(|(_, cell)| cell);
            cells.push((*index, join(*index, Some(cell), same)));
        }
        cells.extend(other.map(|(index, cell)| (*index, join(*index, None, Some(cell)))));
        let mut merged = Self { cells, ..self.clone() };
        for (ours, theirs) in merged.observed.iter_mut().zip(theirs.observed.iter()) {
            *ours = ours.saturating_add(*theirs);
        }
        for (ours, theirs) in merged.support.iter_mut().zip(theirs.support.iter()) {
            *ours = ours.saturating_add(*theirs);
        }
        merged.datum.merge(&theirs.datum);
        merged
    }
}

/// `observed`: passes that had the cell's block in view, ours and theirs.
fn joined(ours: Cell, theirs: Cell, observed: [u16; 2]) -> Cell {
    let both = [ours, theirs].into_iter().filter(|cell| cell.hits > 0);
    let weighted = u64::from(ours.presence) * u64::from(observed[0])
        + u64::from(theirs.presence) * u64::from(observed[1]);
    let passes: u64 = observed.iter().map(|n| u64::from(*n)).sum();
    Cell {
        hits: ours.hits.saturating_add(theirs.hits),
        passes: ours.passes.saturating_add(theirs.passes),
        contributors: ours.contributors.saturating_add(theirs.contributors),
        presence: weighted.checked_div(passes).map_or(0, |mean| mean as u16),
        first_day: both.clone().map(|cell| cell.first_day).min().unwrap_or(0),
        last_day: both.map(|cell| cell.last_day).max().unwrap_or(0),
        offset_sum: [0, 1].map(|axis: usize| ours.offset_sum[axis].saturating_add(theirs.offset_sum[axis])),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{folded, uploads};
    use super::*;
    use crate::evidence::presence::ALWAYS;
    use proptest::prelude::*;

    #[test]
    fn cells_of_both_are_there_and_those_in_common_add_up() {
        let cell = |hits, day| Cell {
            hits,
            passes: 1,
            contributors: 1,
            presence: ALWAYS,
            first_day: day,
            last_day: day,
            offset_sum: [hits, 7],
        };
        let tile = |cells: &[(u32, u32, u16)]| {
            let cells = cells.iter().map(|(index, hits, day)| (*index, cell(*hits, *day)));
            Tile::from_cells(cells.collect()).unwrap()
        };
        let (ours, theirs) = (tile(&[(3, 1, 10), (5, 2, 10)]), tile(&[(1, 4, 9), (5, 6, 9), (8, 1, 9)]));
        let merged = ours.merged(&theirs);
        let indices: Vec<_> = merged.cells().iter().map(|(index, _)| *index).collect();
        assert_eq!(indices, [1, 3, 5, 8]);
        let common = merged.cells()[2].1;
        assert_eq!((common.hits, common.passes, common.contributors, common.presence), (8, 2, 2, ALWAYS));
        assert_eq!((common.first_day, common.last_day, common.offset_sum), (9, 10, [8, 14]));
        // What only one map saw, though both had it in view, is half as present.
        assert_eq!(merged.cells()[0].1.presence, ALWAYS / 2);
    }

    proptest! {
        #[test]
        fn where_one_map_has_nothing_the_other_is_taken_as_it_is(uploads in uploads()) {
            let (tile, _) = folded(&uploads);
            prop_assert_eq!(&Tile::default().merged(&tile), &tile);
            prop_assert_eq!(&tile.merged(&Tile::default()), &tile);
        }
    }
}
