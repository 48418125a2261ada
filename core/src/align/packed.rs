//! A tile's weights in a sixth of their bytes: most of a tile is empty.
//!
//! The image is cut into squares of 4 x 4. Of an empty one nothing is held, of any other its bytes, so that answers are the
//! same to the bit. Four bits a weight would halve that again, and find the same place; but they make steps of what is smooth
//! around the summit, whose curvature is the covariance: one answer in ten was refused for want of structure then.

use crate::geo::CELLS_PER_TILE;

/// Cells along the side of a square, which is a coarse cell, too.
pub(super) const SQUARE: usize = 4;
/// Cells of a square.
pub(super) const CELLS: usize = SQUARE * SQUARE;
/// Squares along a tile's side.
const SQUARES: usize = CELLS_PER_TILE / SQUARE;
const _: () = assert!(SQUARES == u128::BITS as usize);

/// A square image of weights, packed.
pub(super) struct PackedWeights {
    rows: Box<[Row]>,
    /// The weights of the squares that are held, row by row.
    squares: Box<[[u8; CELLS]]>,
}

/// A row of squares.
#[derive(Clone, Copy)]
struct Row {
    /// Which of them are held, the westernmost in the lowest bit.
    held: u128,
    /// How many are held before the row.
    before: u32,
}

impl PackedWeights {
    /// Packs a tile's weights, row-major.
    pub(super) fn of(fine: &[u8]) -> Self {
        let (mut rows, mut squares) = (Vec::with_capacity(SQUARES), Vec::new());
        for strip in fine.chunks_exact(CELLS_PER_TILE * SQUARE) {
            let mut row = Row { held: 0, before: squares.len() as u32 };
            for column in 0..SQUARES {
                let square = square_of(strip, column);
                if square != [0; CELLS] {
                    row.held |= 1 << column;
                    squares.push(square);
                }
            }
            rows.push(row);
        }
        Self { rows: rows.into_boxed_slice(), squares: squares.into_boxed_slice() }
    }

    /// Visits the squares that hold any weight, with the column and the row of each, in squares.
    pub(super) fn each(&self, mut visit: impl FnMut(usize, usize, &[u8; CELLS])) {
        for (y, row) in self.rows.iter().enumerate() {
            let mut left = row.held;
            for square in &self.squares[row.before as usize..][..left.count_ones() as usize] {
                visit(left.trailing_zeros() as usize, y, square);
                left &= left - 1;
            }
        }
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.rows) + size_of_val(&*self.squares)
    }
}

fn square_of(strip: &[u8], column: usize) -> [u8; CELLS] {
    let mut square = [0; CELLS];
    for (to, from) in square.chunks_exact_mut(SQUARE).zip(strip.chunks_exact(CELLS_PER_TILE)) {
        to.copy_from_slice(&from[column * SQUARE..][..SQUARE]);
    }
    square
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(in crate::align) fn unpacked(packed: &PackedWeights) -> Vec<u8> {
        let mut fine = vec![0; CELLS_PER_TILE * CELLS_PER_TILE];
        packed.each(|x, y, weights| {
            for (row, from) in weights.chunks_exact(SQUARE).enumerate() {
                fine[(y * SQUARE + row) * CELLS_PER_TILE + x * SQUARE..][..SQUARE].copy_from_slice(from);
            }
        });
        fine
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]

        // Breaks it: a square taken for another, or its weights mirrored.
        #[test]
        fn what_is_packed_is_what_was_there(
            spots in prop::collection::vec((0..CELLS_PER_TILE * CELLS_PER_TILE, 1..=255_u8), 0..500),
        ) {
            let mut fine = vec![0_u8; CELLS_PER_TILE * CELLS_PER_TILE];
            for (at, weight) in spots {
                let run = fine[at..].iter_mut().take(5);
                run.for_each(|cell| *cell = weight);
            }
            prop_assert!(unpacked(&PackedWeights::of(&fine)) == fine);
        }
    }

    #[test]
    fn nothing_takes_next_to_nothing() {
        let packed = PackedWeights::of(&vec![0; CELLS_PER_TILE * CELLS_PER_TILE]);
        assert!(packed.bytes() <= SQUARES * size_of::<Row>());
        assert!(unpacked(&packed).iter().all(|weight| *weight == 0));
    }
}
