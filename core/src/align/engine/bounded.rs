//! The exact maximum by bounds: shifts are taken in blocks of 8 x 8, and a block whose bound does not
//! reach the best sum known holds no maximum.
//!
//! 1. The coarse-to-fine search gives a hypothesis that nearly always is the maximum.
//! 2. The sum of the map's largest weights around each cell bounds all 64 shifts of a block at once.
//! 3. The few blocks that are left are summed up, the highest bound first.
//!
//! Where too many are left (weights that are flat over a block), or the batch is so dense that they
//! would be, every hypothesis is computed by the FFT instead.

use std::cmp::Reverse;

use super::{Engine, Fast, Fft, Peak, Question};
use crate::align::cells::Once;
use crate::align::simd::{Isa, Strips};
use crate::align::view::{Shown, Square};

/// Shifts along the side of a block.
const BLOCK: usize = 8;
/// Blocks to a strip of bounds, and shifts to a strip of sums.
const STRIP: usize = 16;
/// Blocks left beyond which the FFT is faster.
const TOO_MANY: usize = 2500;
/// Occupied cells of a batch beyond which the FFT is faster: most blocks of a batch so dense are left.
const DENSE: usize = 40_000;
/// Half width of the search for the best sum around a hill that was found, cells.
const AROUND: usize = 5;

/// The engine and its buffers.
#[derive(Default)]
pub struct Bounded {
    isa: Isa,
    fast: Fast,
    fft: Fft,
    /// What `bounds` was made of.
    of: Option<Square>,
    /// The largest weight of the 8 x 8 cells north-east of each cell: columns of one remainder by 8
    /// side by side, so that neighbouring blocks of shifts are neighbours in memory.
    bounds: Vec<u8>,
    /// The same, row by row.
    largest: Vec<u8>,
    once: Once,
    /// Occupied cells by heading.
    occupied: Vec<Vec<u32>>,
    places: Vec<u32>,
    /// Bounds of a heading's blocks, a strip of columns at a time.
    sums: Vec<[u32; STRIP]>,
    left: Vec<Block>,
}

/// A block of shifts that may hold the maximum.
#[derive(Clone, Copy)]
struct Block {
    bound: u32,
    heading: usize,
    row: usize,
    column: usize,
}

/// The best sum so far, and where it first is.
#[derive(Clone, Copy, Default)]
struct Best {
    sum: u32,
    index: usize,
}

impl Best {
    fn take(&mut self, index: usize, sum: u32) {
        if sum > self.sum || (sum == self.sum && index < self.index) {
            *self = Self { sum, index };
        }
    }
}

impl Engine for Bounded {
    fn name(&self) -> &'static str {
        "bounded"
    }

    fn search(&mut self, question: &Question, peaks: &mut Vec<Peak>) {
        let middle = &mut self.places;
        question.occupied(self.isa, question.lattice.turns, &mut self.once, middle);
        if middle.len() > DENSE {
            self.fft.search(question, peaks);
            return;
        }
        self.fast.search(question, peaks);
        self.refresh(question);
        let headings = question.lattice.headings();
        // Those of a wider search are kept for the next one.
        self.occupied.resize_with(self.occupied.len().max(headings), Vec::new);
        for (heading, occupied) in self.occupied[..headings].iter_mut().enumerate() {
            question.occupied(self.isa, heading, &mut self.once, occupied);
        }
        let mut best = Best::default();
        if let Some(peak) = peaks.first() {
            self.known(question, peak, &mut best);
        }
        self.bound(question, best.sum);
        if self.left.len() > TOO_MANY {
            self.fft.search(question, peaks);
            return;
        }
        self.left.sort_unstable_by_key(|block| Reverse(block.bound));
        for i in 0..self.left.len() {
            let block = self.left[i];
            if block.bound < best.sum {
                break;
            }
            self.sum_up(question, block.heading, [block.row, block.column], BLOCK, &mut best);
        }
        let top = question.peak(best.index, best.sum);
        peaks.retain(|p| p.correction.distance_m(&top.correction) >= question.search.separation_m);
        peaks.insert(0, top);
        peaks.truncate(question.search.peaks);
    }
}

impl Bounded {
    /// The engine on one instruction set.
    #[must_use]
    pub fn on(isa: Isa) -> Self {
        Self { isa, fast: Fast::on(isa), ..Self::default() }
    }

    /// Blocks of shifts that were left to be summed up in the last search.
    #[must_use]
    pub fn left(&self) -> usize {
        self.left.len()
    }

    /// The bounds of the map, unless they are those of the last question.
    fn refresh(&mut self, question: &Question) {
        let square = question.view.square();
        if !self.of.as_ref().is_some_and(|of| of.is(square.frame, &square.tiles)) {
            bounds(&question.view.fine(), &mut self.largest, &mut self.bounds);
            Square::note(&mut self.of, square.frame, &square.tiles);
        }
    }

    /// The best sum around a hill that was found.
    fn known(&mut self, question: &Question, peak: &Peak, best: &mut Best) {
        let lattice = question.lattice;
        let step = |value: f64, unit: f64, half: usize| {
            ((value / unit).round() + half as f64).clamp(0.0, 2.0 * half as f64) as usize
        };
        let cell = crate::geo::CELL_M;
        let heading = step(peak.correction.yaw_rad, lattice.yaw_step_rad, lattice.turns);
        let row = step(peak.correction.y_m, cell, lattice.lag).saturating_sub(AROUND);
        let column = step(peak.correction.x_m, cell, lattice.lag).saturating_sub(AROUND);
        let headings = heading.saturating_sub(1)..(heading + 2).min(lattice.headings());
        for heading in headings {
            self.sum_up(question, heading, [row, column], 2 * AROUND + 1, best);
        }
    }

    /// Sums of the shifts of a square of the lattice.
    fn sum_up(
        &mut self,
        question: &Question,
        heading: usize,
        [row, column]: [usize; 2],
        size: usize,
        best: &mut Best,
    ) {
        let (lattice, shown) = (question.lattice, question.view.fine());
        let rows = size.min(lattice.width() - row);
        let columns = size.min(lattice.width() - column);
        let shift = (row * shown.side + column) as u32;
        self.places.clear();
        self.places.extend(self.occupied[heading].iter().map(|place| place + shift));
        let strips = Strips::<STRIP> { image: shown.image, stride: shown.side, rows };
        let mut sums = [[0; STRIP]; 2 * AROUND + 1];
        strips.add(self.isa, &self.places, &mut sums[..rows]);
        for (y, sums) in sums[..rows].iter().enumerate() {
            let first = heading * lattice.plane() + (row + y) * lattice.width() + column;
            for (x, sum) in sums[..columns].iter().enumerate() {
                best.take(first + x, *sum);
            }
        }
    }

    /// Blocks whose bound reaches a sum.
    fn bound(&mut self, question: &Question, sum: u32) {
        let (lattice, side) = (question.lattice, question.view.frame().side);
        let blocks = lattice.width().div_ceil(BLOCK);
        let wide = side / BLOCK;
        self.sums.resize(blocks, [0; STRIP]);
        self.left.clear();
        for heading in 0..lattice.headings() {
            self.places.clear();
            // A product instead of a division: exact, for a row's end is half a cell away.
            let rows = 1.0 / side as f64;
            self.places.extend(self.occupied[heading].iter().map(|place| {
                let y = ((f64::from(*place) + 0.5) * rows) as u32;
                let x = place - y * side as u32;
                (x % BLOCK as u32 * side as u32 + y) * wide as u32 + x / BLOCK as u32
            }));
            for first in (0..blocks).step_by(STRIP) {
                let strips = Strips::<STRIP> { image: &self.bounds, stride: BLOCK * wide, rows: blocks };
                self.sums.fill([0; STRIP]);
                strips.add(self.isa, &self.places, &mut self.sums);
                for (row, sums) in self.sums.iter().enumerate() {
                    let columns = STRIP.min(blocks - first);
                    let reach = sums[..columns].iter().enumerate().filter(|(_, bound)| **bound >= sum);
                    self.left.extend(reach.map(|(column, bound)| Block {
                        bound: *bound,
                        heading,
                        row: row * BLOCK,
                        column: (first + column) * BLOCK,
                    }));
                }
                self.places.iter_mut().for_each(|place| *place += STRIP as u32);
            }
        }
    }
}

/// Writes the largest of the 8 x 8 weights north-east of each cell, columns sorted by remainder.
fn bounds(shown: &Shown, largest: &mut Vec<u8>, out: &mut Vec<u8>) {
    let side = shown.side;
    largest.clear();
    largest.extend_from_slice(&shown.image[..side * side]);
    for reach in [1, 2, 4] {
        for row in largest.chunks_exact_mut(side) {
            for x in 0..side - reach {
                row[x] = row[x].max(row[x + reach]);
            }
        }
    }
    for reach in [1, 2, 4] {
        for y in 0..side - reach {
            let (row, north) = largest[y * side..].split_at_mut(reach * side);
            for (value, other) in row[..side].iter_mut().zip(&north[..side]) {
                *value = (*value).max(*other);
            }
        }
    }
    let wide = side / BLOCK;
    out.clear();
    out.resize(side * side + STRIP + side, 0);
    for (y, row) in largest.chunks_exact(side).enumerate() {
        for remainder in 0..BLOCK {
            let to = (remainder * side + y) * wide;
            for (value, x) in out[to..to + wide].iter_mut().zip((remainder..side).step_by(BLOCK)) {
                *value = row[x];
            }
        }
    }
}
