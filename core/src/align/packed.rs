//! A tile's weights in a tenth of their bytes: most of a tile is empty, and what is not is smooth.
//!
//! The image is cut into squares of 8 x 8. Of an empty one nothing is held; of any other the largest weight, and four bits for
//! each weight, in fifteenths of it. That is as exact as whole bytes where it matters: a score is the sum of many
//! weights (docs/benchmarks/service.md, "Packed weights").

use crate::geo::CELLS_PER_TILE;

/// Cells along the side of a square.
pub(super) const SQUARE: usize = 8;
const CELLS: usize = SQUARE * SQUARE;
/// Squares along a tile's side: one bit each fits a word.
const SQUARES: usize = CELLS_PER_TILE / SQUARE;
const _: () = assert!(SQUARES == 64);
/// Steps of a weight.
const LEVELS: u16 = 15;

/// A square image of weights, packed.
pub(super) struct PackedWeights {
    rows: Box<[Row]>,
    /// The largest weight of each square that is held.
    largest: Box<[u8]>,
    /// Its weights: in byte `i` those of cells `i` (low) and `i + 32`, row by row.
    levels: Box<[[u8; CELLS / 2]]>,
}

/// A row of squares.
#[derive(Clone, Copy, Default)]
struct Row {
    /// Which of them are held, the westernmost in the lowest bit.
    held: u64,
    /// How many are held before the row.
    before: u32,
}

impl PackedWeights {
    /// Packs a tile's weights, row-major.
    pub(super) fn of(fine: &[u8]) -> Self {
        let (mut rows, mut largest, mut levels) = (Vec::with_capacity(SQUARES), Vec::new(), Vec::new());
        for strip in fine.chunks_exact(CELLS_PER_TILE * SQUARE) {
            let mut row = Row { held: 0, before: largest.len() as u32 };
            for column in 0..SQUARES {
                let square = square_of(strip, column);
                let most = square.iter().copied().max().unwrap_or(0);
                if most > 0 {
                    row.held |= 1 << column;
                    largest.push(most);
                    levels.push(packed(&square, most));
                }
            }
            rows.push(row);
        }
        Self {
            rows: rows.into_boxed_slice(),
            largest: largest.into_boxed_slice(),
            levels: levels.into_boxed_slice(),
        }
    }

    /// Visits the squares that hold any weight, with the column and the row of each, in squares.
    pub(super) fn each(&self, mut visit: impl FnMut(usize, usize, &[u8; CELLS])) {
        let mut weights = [0; CELLS];
        for (y, row) in self.rows.iter().enumerate() {
            let (mut left, mut at) = (row.held, row.before as usize);
            while left != 0 {
                unpack(&self.levels[at], self.largest[at], &mut weights);
                visit(left.trailing_zeros() as usize, y, &weights);
                left &= left - 1;
                at += 1;
            }
        }
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.rows) + size_of_val(&*self.largest) + size_of_val(&*self.levels)
    }
}

fn square_of(strip: &[u8], column: usize) -> [u8; CELLS] {
    let mut square = [0; CELLS];
    for (to, from) in square.chunks_exact_mut(SQUARE).zip(strip.chunks_exact(CELLS_PER_TILE)) {
        to.copy_from_slice(&from[column * SQUARE..][..SQUARE]);
    }
    square
}

fn packed(square: &[u8; CELLS], most: u8) -> [u8; CELLS / 2] {
    let most = u16::from(most);
    // A trace of structure stays one.
    let level = |weight: u8| match u16::from(weight) {
        0 => 0,
        weight => (((2 * weight * LEVELS + most) / (2 * most)) as u8).max(1),
    };
    std::array::from_fn(|i| level(square[i]) | level(square[i + CELLS / 2]) << 4)
}

/// Plain arithmetic in one loop, so that it is vectorised.
fn unpack(levels: &[u8; CELLS / 2], most: u8, weights: &mut [u8; CELLS]) {
    let step = (u16::from(most) * 256).div_ceil(LEVELS);
    let (low, high) = weights.split_at_mut(CELLS / 2);
    for ((level, low), high) in levels.iter().zip(low).zip(high) {
        // At most 15 times a 15th of 256 times 255, and rounding: it fits.
        *low = (u16::from(level & 15).wrapping_mul(step) >> 8) as u8;
        *high = (u16::from(level >> 4).wrapping_mul(step) >> 8) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unpacked(packed: &PackedWeights) -> Vec<u8> {
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

        // Breaks it: a level of one square taken for another's, weights mirrored, or one that overflows.
        #[test]
        fn every_weight_is_within_half_a_level(
            spots in prop::collection::vec((0..CELLS_PER_TILE * CELLS_PER_TILE, 1..=255_u8), 0..500),
        ) {
            let mut fine = vec![0_u8; CELLS_PER_TILE * CELLS_PER_TILE];
            for (at, weight) in spots {
                let run = fine[at..].iter_mut().take(5);
                run.for_each(|cell| *cell = weight);
            }
            let packed = PackedWeights::of(&fine);
            let back = unpacked(&packed);
            for (at, (was, is)) in fine.iter().zip(&back).enumerate() {
                let strip = &fine[at / (CELLS_PER_TILE * SQUARE) * CELLS_PER_TILE * SQUARE..];
                let square = square_of(&strip[..CELLS_PER_TILE * SQUARE], at % CELLS_PER_TILE / SQUARE);
                let most = square.iter().copied().max().unwrap_or(0);
                prop_assert!(was.abs_diff(*is) <= (most / 30 + 1).max(most.div_ceil(15) - u8::from(*was > most / 15)), "{was} {is} of {most}");
                prop_assert_eq!(*was == 0, *is == 0);
                prop_assert!(*was != most || is == was, "the largest is exact");
            }
        }
    }

    #[test]
    fn nothing_takes_next_to_nothing() {
        let packed = PackedWeights::of(&vec![0; CELLS_PER_TILE * CELLS_PER_TILE]);
        assert!(packed.bytes() <= SQUARES * size_of::<Row>());
        assert!(unpacked(&packed).iter().all(|weight| *weight == 0));
    }
}
