//! The search that uploads are vetted by: coarse to fine, with every second heading and five hills.
//!
//! [`Fast`](super::Fast) misses less. But by how much vetting moves an upload is part of the map, and another search would
//! move it by some millimetres more or less: every map would be folded anew, and every vehicle would download it anew.

use std::cmp::Reverse;

use super::question::mean_weight;
use super::{Candidate, Engine, EngineWorkspace, SearchQuestion};
use crate::align::simd::{Isa, Strips};
use crate::align::view::ImageView;
use crate::geo::CELL_M;
use crate::point::WeightedPoint;
use crate::pose::Pose2;

/// Shifts to a strip where all are scanned: the bytes of a 256-bit register. It changes the time, not the
/// answer.
const WIDE: usize = 32;
/// Shifts to a strip around a candidate: the least power of two that holds the 11 of [`FINE`].
const NARROW: usize = 16;
/// Points that a scan of all hypotheses counts, at most, or little more. A scan's time is in proportion; a
/// batch of a town has some 3200 points, so it counts every fifth. What that costs is the miss rate.
const SCANNED: usize = 600;
/// Points that the search around a candidate counts, at most, or little more. More than a scan's, for these
/// sums rank the candidates, and only some hundred hypotheses are tried. What it costs is the miss rate.
const SHARPENED: usize = 1000;
/// Hypotheses of a scan of the coarse image beyond which a coarser one is scanned before it. A prior of 2 m
/// and 3 degrees has 18 000 and is scanned at once; one of 4 m has 71 000; 30 m with all headings have
/// eight million.
const MANY: usize = 60_000;
/// Candidates that the coarser image hands on, against the search's five of the coarse one: its pixels
/// are 0.8 m wide, four times the sigma of the smoothing, and order candidates less surely. What it costs is
/// the miss rate.
const FROM_COARSER: usize = 32;
/// Around a candidate of the coarser image, on the coarse one: its pixel is two wide, so that one pixel
/// reaches its border and two more span a neighbour. Turns were scanned by four steps: two steps of two on
/// either side reach the next ones.
const COARSE: Around = Around { pixels: 3, turns: 2, step: 2 };
/// Around a candidate of the coarse image, on the fine one: its pixel is four cells wide, so that two cells
/// reach its border and three more into its neighbours. Turns were scanned by two steps: one on either side
/// is what was left out.
const FINE: Around = Around { pixels: 5, turns: 1, step: 1 };
const _: () = assert!(2 * FINE.pixels < NARROW && 2 * COARSE.pixels < NARROW);

/// The engine.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stepped {
    isa: Option<Isa>,
}

/// Buffers, and the instruction set they are filled with.
#[derive(Default)]
struct SteppedBuffers {
    isa: Isa,
    pixels: Vec<u32>,
    sums: Vec<[u32; WIDE]>,
    /// For each shift of a scan the best sum and its turn, fine steps.
    best: Vec<(u32, i32)>,
    coarser: Vec<u8>,
}

/// A search around a candidate: half widths in pixels and turns, and the step of a turn in fine steps.
struct Around {
    pixels: usize,
    turns: i32,
    step: i32,
}

impl Stepped {
    /// The engine on the fastest instruction set of this processor.
    pub const BEST: Self = Self { isa: None };

    /// The engine on one instruction set.
    #[must_use]
    pub fn on(isa: Isa) -> Self {
        Self { isa: Some(isa) }
    }
}

impl Engine for Stepped {
    fn name(&self) -> &'static str {
        "fast"
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        let buffers = workspace.buffers::<SteppedBuffers>();
        buffers.isa = self.isa.unwrap_or_default();
        for (question, candidates) in questions.iter().zip(candidates) {
            buffers.search(question, candidates);
        }
    }
}

impl SteppedBuffers {
    fn search(&mut self, question: &SearchQuestion, candidates: &mut Vec<Candidate>) {
        let coarse = question.view.coarse();
        let shifts = 2 * question.lattice.lag.div_ceil(coarse.cells) + 1;
        if shifts * shifts * question.lattice.headings() > MANY {
            let mut image = std::mem::take(&mut self.coarser);
            let coarser = halved(&coarse, &mut image);
            self.scan(question, &coarser, 4);
            self.highest(question, &coarser, FROM_COARSER, candidates);
            self.sharpen(question, &coarse, &COARSE, candidates);
            self.coarser = image;
        } else {
            self.scan(question, &coarse, 2);
            self.highest(question, &coarse, question.search.candidates, candidates);
        }
        self.sharpen(question, &question.view.fine(), &FINE, candidates);
        candidates.truncate(question.search.candidates);
    }

    /// Sums of an image for every shift of its pixels and every `step`th turn, reduced to the best
    /// turn.
    fn scan(&mut self, question: &SearchQuestion, image: &ImageView, step: usize) {
        let lag = question.lattice.lag.div_ceil(image.cells);
        let width = 2 * lag + 1;
        let turns = question.lattice.turns.div_ceil(step) as i32;
        self.best.clear();
        self.best.resize(width * width, (0, 0));
        self.sums.resize(width, [0; WIDE]);
        let strips = Strips::<WIDE> { image: image.weights, stride: image.side, rows: width };
        let stride = (question.thinned.len() / SCANNED).max(1);
        for turn in -turns..=turns {
            let turn = turn * step as i32;
            let at = Pose2::new(0.0, 0.0, f64::from(turn) * question.lattice.yaw_step_rad);
            let points = question.thinned.iter().step_by(stride).map(WeightedPoint::position);
            question.projection(image, lag).pixel_indices(self.isa, at, points, &mut self.pixels);
            for first in (0..width).step_by(WIDE) {
                self.sums.fill([0; WIDE]);
                strips.add(self.isa, &self.pixels, &mut self.sums);
                let columns = WIDE.min(width - first);
                for (row, sums) in self.sums.iter().enumerate() {
                    let from = row * width + first;
                    for (best, sum) in self.best[from..from + columns].iter_mut().zip(sums) {
                        if *sum > best.0 {
                            *best = (*sum, turn);
                        }
                    }
                }
                self.pixels.iter_mut().for_each(|pixel| *pixel += WIDE as u32);
            }
        }
    }

    /// The highest shifts of the last scan, none within the separation of a higher one. Their scores are
    /// those of the search around them, which follows.
    fn highest(
        &mut self,
        question: &SearchQuestion,
        image: &ImageView,
        most: usize,
        candidates: &mut Vec<Candidate>,
    ) {
        let lag = question.lattice.lag.div_ceil(image.cells);
        let width = 2 * lag + 1;
        let pixel_m = image.cells as f64 * CELL_M;
        let separation = (question.search.separation_m / pixel_m).powi(2);
        candidates.clear();
        while candidates.len() < most {
            let top = self.best.iter().enumerate().max_by_key(|(i, (sum, _))| (*sum, Reverse(*i)));
            let Some((index, &(_, turn))) = top.filter(|(_, (sum, _))| *sum > 0) else { break };
            let (row, column) = (index / width, index % width);
            self.clear_around(row, column, width, separation);
            let shift = |i: usize| (i as f64 - lag as f64) * pixel_m;
            let yaw_rad = f64::from(turn) * question.lattice.yaw_step_rad;
            let at_edge = lag > 0 && [row, column].iter().any(|i| *i == 0 || *i == 2 * lag);
            let correction = Pose2::new(shift(column), shift(row), yaw_rad);
            candidates.push(Candidate { correction, score: 0.0, at_edge });
        }
    }

    /// Forgets the shifts within the separation of one; `separation` is its square, pixels.
    fn clear_around(&mut self, row: usize, column: usize, width: usize, separation: f64) {
        let reach = separation.sqrt().ceil() as usize;
        for other_row in row.saturating_sub(reach)..(row + reach + 1).min(width) {
            for other_column in column.saturating_sub(reach)..(column + reach + 1).min(width) {
                let (dr, dc) = (other_row.abs_diff(row), other_column.abs_diff(column));
                if ((dr * dr + dc * dc) as f64) < separation {
                    self.best[other_row * width + other_column].0 = 0;
                }
            }
        }
    }

    /// Moves candidates to the best hypotheses around them on a finer image, and sorts them.
    fn sharpen(
        &mut self,
        question: &SearchQuestion,
        image: &ImageView,
        around: &Around,
        candidates: &mut [Candidate],
    ) {
        for candidate in candidates.iter_mut() {
            self.sharpen_one(question, image, around, candidate);
        }
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    }

    fn sharpen_one(
        &mut self,
        question: &SearchQuestion,
        image: &ImageView,
        around: &Around,
        candidate: &mut Candidate,
    ) {
        let width = 2 * around.pixels + 1;
        let strips = Strips::<NARROW> { image: image.weights, stride: image.side, rows: width };
        let (from, yaw_step) = (candidate.correction, question.lattice.yaw_step_rad);
        let pixel_m = image.cells as f64 * CELL_M;
        let turn = (from.yaw_rad / yaw_step).round() as i32;
        let stride = question.thinned.len().div_ceil(SHARPENED).max(1);
        let points = question.thinned.iter().step_by(stride).map(WeightedPoint::position);
        let mut sums = [[0_u32; NARROW]; NARROW];
        let mut highest = 0;
        for turn in (-around.turns..=around.turns).map(|i| turn + i * around.step) {
            let at = Pose2::new(from.x_m, from.y_m, f64::from(turn) * yaw_step);
            let projection = question.projection(image, around.pixels);
            projection.pixel_indices(self.isa, at, points.clone(), &mut self.pixels);
            sums.fill([0; NARROW]);
            strips.add(self.isa, &self.pixels, &mut sums[..width]);
            for (row, sums) in sums[..width].iter().enumerate() {
                for (column, sum) in sums[..width].iter().enumerate() {
                    if *sum > highest {
                        let shift = |i: usize| (i as f64 - around.pixels as f64) * pixel_m;
                        let yaw_rad = f64::from(turn) * yaw_step;
                        candidate.correction =
                            Pose2::new(from.x_m + shift(column), from.y_m + shift(row), yaw_rad);
                        highest = *sum;
                    }
                }
            }
        }
        candidate.score = mean_weight(highest, points.len());
    }
}

/// An image with pixels twice as wide: means of 2 x 2, rounded up.
fn halved<'a>(image: &ImageView, out: &'a mut Vec<u8>) -> ImageView<'a> {
    let side = image.side / 2;
    out.clear();
    out.resize(side * side + 2 * WIDE, 0);
    for y in 0..side {
        for x in 0..side {
            let at = 2 * y * image.side + 2 * x;
            let four = [at, at + 1, at + image.side, at + image.side + 1];
            let sum: u16 = four.iter().map(|i| u16::from(image.weights[*i])).sum();
            out[y * side + x] = sum.div_ceil(4) as u8;
        }
    }
    ImageView { square: image.square, cells: 2 * image.cells, side, weights: out }
}
