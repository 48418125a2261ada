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

use super::{Candidate, Engine, EngineWorkspace, Fast, Fft, SearchQuestion};
use crate::align::projection::DistinctPixels;
use crate::align::simd::{Isa, Strips};
use crate::align::view::{ImageView, WindowTiles};

/// Shifts along the side of a block.
const BLOCK: usize = 8;
/// Blocks to a strip of bounds, and shifts to a strip of sums.
const STRIP: usize = 16;
/// Blocks left beyond which the FFT is faster.
const TOO_MANY: usize = 2500;
/// Occupied cells of a batch beyond which the FFT is faster: most blocks of a batch so dense are left.
const DENSE: usize = 40_000;
/// Half width of the search for the best sum around a candidate that was found, cells.
const AROUND: usize = 5;

/// The engine.
#[derive(Debug, Clone, Copy, Default)]
pub struct Bounded {
    isa: Option<Isa>,
}

/// What is known of the last map, and buffers.
#[derive(Default)]
struct BoundedBuffers {
    /// What `bounds` was made of.
    of: Option<WindowTiles>,
    /// The largest weight of the 8 x 8 cells north-east of each cell: columns of one remainder by 8
    /// side by side, so that neighbouring blocks of shifts are neighbours in memory.
    bounds: Vec<u8>,
    /// The same, row by row.
    largest: Vec<u8>,
    distinct: DistinctPixels,
    /// Occupied cells by heading.
    occupied: Vec<Vec<u32>>,
    pixels: Vec<u32>,
    /// Bounds of a heading's blocks, a strip of columns at a time.
    sums: Vec<[u32; STRIP]>,
    left: Vec<ShiftBlock>,
}

/// A block of shifts that may hold the maximum.
#[derive(Clone, Copy)]
struct ShiftBlock {
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
    fn raise(&mut self, index: usize, sum: u32) {
        if sum > self.sum || (sum == self.sum && index < self.index) {
            *self = Self { sum, index };
        }
    }
}

impl Engine for Bounded {
    fn name(&self) -> &'static str {
        "bounded"
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        for (question, candidates) in questions.iter().zip(candidates) {
            self.search_one(question, workspace, candidates);
        }
    }
}

impl Bounded {
    /// The engine on the fastest instruction set of this processor.
    pub const BEST: Self = Self { isa: None };

    /// The engine on one instruction set.
    #[must_use]
    pub fn on(isa: Isa) -> Self {
        Self { isa: Some(isa) }
    }

    fn search_one(
        self,
        question: &SearchQuestion,
        workspace: &mut EngineWorkspace,
        candidates: &mut Vec<Candidate>,
    ) {
        let isa = self.isa.unwrap_or_default();
        let cells = workspace.buffers::<BoundedBuffers>().cells(isa, question);
        if cells > DENSE {
            return Fft.search(question, workspace, candidates);
        }
        Fast::on(isa).search(question, workspace, candidates);
        let Some(best) = workspace.buffers::<BoundedBuffers>().maximum(isa, question, candidates.first())
        else {
            return Fft.search(question, workspace, candidates);
        };
        let top = question.candidate(best.index, best.sum, cells);
        candidates.retain(|c| c.correction.distance_m(&top.correction) >= question.search.separation_m);
        candidates.insert(0, top);
        candidates.truncate(question.search.candidates);
    }
}

impl BoundedBuffers {
    /// How many cells the batch occupies under the prior's heading.
    fn cells(&mut self, isa: Isa, question: &SearchQuestion) -> usize {
        question.occupied(isa, question.lattice.turns, &mut self.distinct, &mut self.pixels);
        self.pixels.len()
    }

    /// The maximum, from a candidate that is near it or not; `None` where too many blocks are left.
    fn maximum(&mut self, isa: Isa, question: &SearchQuestion, near: Option<&Candidate>) -> Option<Best> {
        self.refresh(question);
        let headings = question.lattice.headings();
        // The lists of a wider search stay for the next one.
        self.occupied.resize_with(self.occupied.len().max(headings), Vec::new);
        for (heading, occupied) in self.occupied[..headings].iter_mut().enumerate() {
            question.occupied(isa, heading, &mut self.distinct, occupied);
        }
        let mut best = Best::default();
        if let Some(candidate) = near {
            self.known(isa, question, candidate, &mut best);
        }
        self.bound(isa, question, best.sum);
        if self.left.len() > TOO_MANY {
            return None;
        }
        self.left.sort_unstable_by_key(|block| Reverse(block.bound));
        for i in 0..self.left.len() {
            let block = self.left[i];
            if block.bound < best.sum {
                break;
            }
            self.sum_up(isa, question, block.heading, [block.row, block.column], BLOCK, &mut best);
        }
        Some(best)
    }

    /// The bounds of the map, unless they are those of the last question.
    fn refresh(&mut self, question: &SearchQuestion) {
        let WindowTiles { square, tiles } = question.view.window();
        if !self.of.as_ref().is_some_and(|of| of.same_tiles(*square, tiles)) {
            bounds(&question.view.fine(), &mut self.largest, &mut self.bounds);
            WindowTiles::record(&mut self.of, *square, tiles);
        }
    }

    /// The best sum around a candidate that was found.
    fn known(&mut self, isa: Isa, question: &SearchQuestion, candidate: &Candidate, best: &mut Best) {
        let lattice = question.lattice;
        let step = |value: f64, unit: f64, half: usize| {
            ((value / unit).round() + half as f64).clamp(0.0, 2.0 * half as f64) as usize
        };
        let cell = crate::geo::CELL_M;
        let heading = step(candidate.correction.yaw_rad, lattice.yaw_step_rad, lattice.turns);
        let row = step(candidate.correction.y_m, cell, lattice.lag).saturating_sub(AROUND);
        let column = step(candidate.correction.x_m, cell, lattice.lag).saturating_sub(AROUND);
        let headings = heading.saturating_sub(1)..(heading + 2).min(lattice.headings());
        for heading in headings {
            self.sum_up(isa, question, heading, [row, column], 2 * AROUND + 1, best);
        }
    }

    /// Sums of the shifts of a square of the lattice.
    fn sum_up(
        &mut self,
        isa: Isa,
        question: &SearchQuestion,
        heading: usize,
        [row, column]: [usize; 2],
        size: usize,
        best: &mut Best,
    ) {
        let (lattice, image) = (question.lattice, question.view.fine());
        let rows = size.min(lattice.width() - row);
        let columns = size.min(lattice.width() - column);
        let shift = (row * image.side + column) as u32;
        self.pixels.clear();
        self.pixels.extend(self.occupied[heading].iter().map(|pixel| pixel + shift));
        let strips = Strips::<STRIP> { image: image.weights, stride: image.side, rows };
        let mut sums = [[0; STRIP]; 2 * AROUND + 1];
        strips.add(isa, &self.pixels, &mut sums[..rows]);
        for (y, sums) in sums[..rows].iter().enumerate() {
            let first = heading * lattice.plane() + (row + y) * lattice.width() + column;
            for (x, sum) in sums[..columns].iter().enumerate() {
                best.raise(first + x, *sum);
            }
        }
    }

    /// Blocks whose bound reaches a sum.
    fn bound(&mut self, isa: Isa, question: &SearchQuestion, sum: u32) {
        let (lattice, side) = (question.lattice, question.view.square().side);
        let blocks = lattice.width().div_ceil(BLOCK);
        let wide = side / BLOCK;
        self.sums.resize(blocks, [0; STRIP]);
        self.left.clear();
        for heading in 0..lattice.headings() {
            self.pixels.clear();
            // A product instead of a division: exact, for a row's end is half a cell away.
            let rows = 1.0 / side as f64;
            self.pixels.extend(self.occupied[heading].iter().map(|pixel| {
                let y = ((f64::from(*pixel) + 0.5) * rows) as u32;
                let x = pixel - y * side as u32;
                (x % BLOCK as u32 * side as u32 + y) * wide as u32 + x / BLOCK as u32
            }));
            for first in (0..blocks).step_by(STRIP) {
                let strips = Strips::<STRIP> { image: &self.bounds, stride: BLOCK * wide, rows: blocks };
                self.sums.fill([0; STRIP]);
                strips.add(isa, &self.pixels, &mut self.sums);
                for (row, sums) in self.sums.iter().enumerate() {
                    let columns = STRIP.min(blocks - first);
                    let reach = sums[..columns].iter().enumerate().filter(|(_, bound)| **bound >= sum);
                    self.left.extend(reach.map(|(column, bound)| ShiftBlock {
                        bound: *bound,
                        heading,
                        row: row * BLOCK,
                        column: (first + column) * BLOCK,
                    }));
                }
                self.pixels.iter_mut().for_each(|pixel| *pixel += STRIP as u32);
            }
        }
    }
}

/// Writes the largest of the 8 x 8 weights north-east of each cell, columns sorted by remainder.
fn bounds(image: &ImageView, largest: &mut Vec<u8>, out: &mut Vec<u8>) {
    let side = image.side;
    largest.clear();
    largest.extend_from_slice(&image.weights[..side * side]);
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
