//! Coarse to fine: every hypothesis on a coarse image with a thinned batch, then the best hills on finer
//! ones.
//!
//! Smoothing makes the map's local maxima wide: the one that is highest on the fine image is among the
//! highest on the coarse one. That is not proven but measured: "Does the fast search find the maximum?"
//! in `docs/benchmarks/search.md` compares the constants below, all together, with the exact maximum. Headings are
//! scanned at every step of the lattice: a step of two misses sharp posts, which at 40 m are passed by within
//! a degree.

use std::cmp::Reverse;

use super::question::mean_weight;
use super::{Candidate, Engine, EngineWorkspace, SearchQuestion};
use crate::align::simd::{Isa, Strips};
use crate::align::view::ImageView;
use crate::geo::CELL_M;
use crate::point::{BodyPoint, WeightedPoint};
use crate::pose::Pose2;

/// Shifts to a strip where all are scanned: the bytes of a 256-bit register. It changes the time, not the
/// answer.
const WIDE: usize = 32;
/// Shifts to a strip around a candidate: the least power of two that holds the 11 of [`FINE`].
const NARROW: usize = 16;
/// Points of which the means are summed up: see [`Strips::add_means`].
const FOUR: u32 = 4;
/// Hypotheses of a scan of the coarse image beyond which a coarser one is scanned before it. A prior of 2 m
/// and 3 degrees has 18 000 and is scanned at once; one of 4 m has 71 000; 30 m with all headings have
/// eight million.
const MANY: usize = 60_000;
/// Around a candidate of the coarser image, on the coarse one: its pixel is two wide, so that one pixel
/// reaches its border and two more span a neighbour. Turns were scanned by two steps: one on either side is what
/// was left out.
const COARSE: Around = Around { pixels: 3, turns: 1 };
/// Around a candidate of the coarse image, on the fine one: its pixel is four cells wide, so that two cells
/// reach its border and three more into its neighbours. A coarse pixel orders headings less surely: one on either
/// side is tried again.
const FINE: Around = Around { pixels: 5, turns: 1 };
/// Around what a few points found on the fine image, with more of them.
const FINEST: Around = Around { pixels: 3, turns: 0 };
/// Candidates more than asked for that are tried with more points.
const SPARE: usize = 2;
const _: () = assert!(2 * FINE.pixels < NARROW && 2 * COARSE.pixels < NARROW);

/// How much a search counts: its time is in proportion, and what less costs is the miss rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Effort {
    /// Points that a scan of all hypotheses counts, at most, or little more; a batch of a town has some 3200.
    scanned: usize,
    /// Points that the first search around each hill counts.
    sketched: usize,
    /// Points that the last search counts, around the best of them. More than a scan's, for these sums rank the
    /// candidates.
    ranked: usize,
    /// Hills that the coarser image hands on: its pixels are 0.8 m wide, four times the sigma of the
    /// smoothing, and order hills less surely.
    from_coarser: usize,
    /// Hills that the coarse image hands on, whatever the number of candidates that is asked for.
    hills: usize,
    /// Hypotheses beyond which the coarser image comes first.
    many: usize,
}

/// The engine.
#[derive(Debug, Clone, Copy)]
pub struct Fast {
    isa: Option<Isa>,
    effort: Effort,
}

impl Default for Fast {
    fn default() -> Self {
        Self::BEST
    }
}

/// Buffers, and the instruction set they are filled with.
#[derive(Default)]
struct FastBuffers {
    isa: Isa,
    /// The points that are counted.
    points: Vec<BodyPoint>,
    pixels: Vec<u32>,
    sums: Vec<[u32; WIDE]>,
    /// For each shift of a scan the best sum and its turn, fine steps.
    best: Vec<(u32, i32)>,
    /// Indices of hills among these.
    hills: Vec<usize>,
    coarser: Vec<u8>,
}

/// A search around a candidate: half widths in pixels and in steps of the heading.
struct Around {
    pixels: usize,
    turns: i32,
}

impl Fast {
    /// The engine on the fastest instruction set of this processor.
    pub const BEST: Self = Self {
        isa: None,
        effort: Effort { scanned: 500, sketched: 200, ranked: 1000, from_coarser: 32, hills: 16, many: MANY },
    };

    /// A glance at a wide area: enough to find what looks alike, not to tell how much.
    pub const GLANCE: Self = Self {
        isa: None,
        effort: Effort { scanned: 250, sketched: 200, ranked: 0, from_coarser: 8, hills: 8, many: 0 },
    };

    /// The engine on one instruction set.
    #[must_use]
    pub fn on(isa: Isa) -> Self {
        Self { isa: Some(isa), ..Self::BEST }
    }
}

impl Engine for Fast {
    fn name(&self) -> &'static str {
        "fast"
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        let buffers = workspace.buffers::<FastBuffers>();
        buffers.isa = self.isa.unwrap_or_default();
        for (question, candidates) in questions.iter().zip(candidates) {
            buffers.search(question, &self.effort, candidates);
        }
    }
}

impl FastBuffers {
    fn search(&mut self, question: &SearchQuestion, effort: &Effort, candidates: &mut Vec<Candidate>) {
        let coarse = question.view.coarse();
        let shifts = 2 * question.lattice.lag.div_ceil(coarse.cells) + 1;
        if shifts * shifts * question.lattice.headings() > effort.many {
            let mut image = std::mem::take(&mut self.coarser);
            let coarser = halved(&coarse, &mut image);
            self.scan(question, effort, &coarser, 2);
            self.highest(question, &coarser, effort.from_coarser, candidates);
            // As few as a glance finds are moved on the fine image at once.
            if effort.from_coarser > effort.hills {
                self.sharpen(question, effort.sketched, &coarse, &COARSE, candidates);
            }
            candidates.truncate(effort.hills.max(question.search.candidates));
            self.coarser = image;
        } else {
            self.scan(question, effort, &coarse, 1);
            self.highest(question, &coarse, effort.hills.max(question.search.candidates), candidates);
        }
        let fine = question.view.fine();
        self.sharpen(question, effort.sketched, &fine, &FINE, candidates);
        candidates.truncate(question.search.candidates + SPARE);
        if effort.ranked > effort.sketched {
            self.sharpen(question, effort.ranked, &fine, &FINEST, candidates);
        }
        candidates.truncate(question.search.candidates);
    }

    /// Sums of an image for every shift of its pixels and every `step`th turn, reduced to the best
    /// turn.
    fn scan(&mut self, question: &SearchQuestion, effort: &Effort, image: &ImageView, step: usize) {
        let lag = question.lattice.lag.div_ceil(image.cells);
        let width = 2 * lag + 1;
        let turns = question.lattice.turns.div_ceil(step) as i32;
        self.best.clear();
        self.best.resize(width * width, (0, 0));
        self.sums.resize(width, [0; WIDE]);
        let strips = Strips::<WIDE> { image: image.weights, stride: image.side, rows: width };
        self.take_points(question, effort.scanned);
        for turn in -turns..=turns {
            let turn = turn * step as i32;
            let at = Pose2::new(0.0, 0.0, f64::from(turn) * question.lattice.yaw_step_rad);
            let points = self.points.iter().copied();
            question.projection(image, lag).pixel_indices(self.isa, at, points, &mut self.pixels);
            for first in (0..width).step_by(WIDE) {
                self.sums.fill([0; WIDE]);
                strips.add_means(self.isa, &self.pixels, &mut self.sums);
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

    /// Takes so many points of the batch, evenly spread, or a few more.
    fn take_points(&mut self, question: &SearchQuestion, most: usize) {
        let stride = (question.thinned.len() / most).max(1);
        self.points.clear();
        self.points.extend(question.thinned.iter().step_by(stride).map(WeightedPoint::position));
    }

    /// The highest hills of the last scan, none within the separation of a higher one. Their scores are
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
        let shift = |i: usize| (i as f64 - lag as f64) * pixel_m;
        self.find_hills(width);
        candidates.clear();
        for &index in &self.hills {
            let (row, column, turn) = (index / width, index % width, self.best[index].1);
            let yaw_rad = f64::from(turn) * question.lattice.yaw_step_rad;
            let correction = Pose2::new(shift(column), shift(row), yaw_rad);
            let near =
                |other: &Candidate| other.correction.distance_m(&correction) < question.search.separation_m;
            if candidates.iter().any(near) {
                continue;
            }
            let at_edge = lag > 0 && [row, column].iter().any(|i| *i == 0 || *i == 2 * lag);
            candidates.push(Candidate { correction, score: 0.0, at_edge });
            if candidates.len() == most {
                break;
            }
        }
    }

    /// Shifts of the last scan that no neighbour exceeds, the highest first.
    fn find_hills(&mut self, width: usize) {
        let Self { best, hills, .. } = self;
        hills.clear();
        for (row, sums) in best.chunks_exact(width).enumerate() {
            for (column, (sum, _)) in sums.iter().enumerate() {
                let rows = row.saturating_sub(1)..(row + 2).min(width);
                let columns = column.saturating_sub(1)..(column + 2).min(width);
                let exceeded = || {
                    rows.clone()
                        .any(|y| best[y * width..][columns.clone()].iter().any(|(other, _)| other > sum))
                };
                if *sum > 0 && !exceeded() {
                    hills.push(row * width + column);
                }
            }
        }
        hills.sort_unstable_by_key(|index| (Reverse(best[*index].0), *index));
    }

    /// Moves candidates to the best hypotheses around them on a finer image, counting so many points, and sorts them.
    fn sharpen(
        &mut self,
        question: &SearchQuestion,
        most_points: usize,
        image: &ImageView,
        around: &Around,
        candidates: &mut Vec<Candidate>,
    ) {
        self.take_points(question, most_points);
        for candidate in candidates.iter_mut() {
            self.sharpen_one(question, image, around, candidate);
        }
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
        // Those that moved onto the same hill are one: else the flanks of the best one would leave no room for others.
        let mut apart = 0;
        for i in 0..candidates.len() {
            let near = |kept: &Candidate| {
                kept.correction.distance_m(&candidates[i].correction) < question.search.separation_m
            };
            if !candidates[..apart].iter().any(near) {
                candidates.swap(apart, i);
                apart += 1;
            }
        }
        candidates.truncate(apart);
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
        let mut sums = [[0_u32; NARROW]; NARROW];
        let mut highest = 0;
        for turn in (-around.turns..=around.turns).map(|i| turn + i) {
            let at = Pose2::new(from.x_m, from.y_m, f64::from(turn) * yaw_step);
            let projection = question.projection(image, around.pixels);
            projection.pixel_indices(self.isa, at, self.points.iter().copied(), &mut self.pixels);
            sums.fill([0; NARROW]);
            strips.add_means(self.isa, &self.pixels, &mut sums[..width]);
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
        candidate.score = mean_weight(FOUR * highest, self.points.len());
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
