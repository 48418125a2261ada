//! A tile of another map joins one of ours.

use echofix_core::evidence::Cell;
use echofix_core::tile::Tile;

/// Both tiles' evidence. Where we have none, theirs is taken as it is.
pub(super) fn merged(ours: &Tile, theirs: Tile) -> Tile {
    if ours.is_empty() {
        return theirs;
    }
    let mut cells = Vec::with_capacity(ours.len() + theirs.len());
    let mut other = theirs.cells().iter().copied().peekable();
    for (index, cell) in ours.cells() {
        while let Some(before) = other.next_if(|(their, _)| their < index) {
            cells.push(before);
        }
        let same = other.next_if(|(their, _)| their == index);
        cells.push((*index, same.map_or(*cell, |(_, theirs)| joined(cell, &theirs))));
    }
    cells.extend(other);
    // Both are in order, and so is what was made of them.
    Tile::from_cells(cells).unwrap_or_else(|| ours.clone())
}

/// Their passes are taken for others than ours: an import counts once, by its file's id.
fn joined(ours: &Cell, theirs: &Cell) -> Cell {
    Cell {
        hits: ours.hits.saturating_add(theirs.hits),
        passes: ours.passes.saturating_add(theirs.passes),
        first_day: ours.first_day.min(theirs.first_day),
        last_day: ours.last_day.max(theirs.last_day),
        offset_sum: [0, 1].map(|axis| ours.offset_sum[axis].saturating_add(theirs.offset_sum[axis])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_of_both_are_there_and_those_in_common_add_up() {
        let cell = |hits, day| Cell { hits, passes: 1, first_day: day, last_day: day, offset_sum: [hits, 7] };
        let tile = |cells: &[(u32, u32, u16)]| {
            Tile::from_cells(cells.iter().map(|(index, hits, day)| (*index, cell(*hits, *day))).collect())
                .unwrap()
        };
        let (ours, theirs) = (tile(&[(3, 1, 10), (5, 2, 10)]), tile(&[(1, 4, 9), (5, 6, 9), (8, 1, 9)]));
        let merged = merged(&ours, theirs.clone());
        let indices: Vec<_> = merged.cells().iter().map(|(index, _)| *index).collect();
        assert_eq!(indices, [1, 3, 5, 8]);
        let common = Cell { hits: 8, passes: 2, first_day: 9, last_day: 10, offset_sum: [8, 14] };
        assert_eq!(merged.cells()[2].1, common);
        assert_eq!(super::merged(&Tile::default(), theirs.clone()), theirs);
    }
}
