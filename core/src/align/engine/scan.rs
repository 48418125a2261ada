//! What searches from coarse to fine share: the scan of every hypothesis on an image, and the search around one.

use super::question::mean_weight;
use super::{Candidate, SearchQuestion};
use crate::align::simd::{Isa, Strips};
use crate::align::view::ImageView;
use crate::geo::CELL_M;
use crate::point::{BodyPoint, WeightedPoint};
use crate::pose::Pose2;

/// Shifts to a strip where all are scanned: the bytes of a 256-bit register. It changes the time, not the
/// answer.
const WIDE: usize = 32;
/// Shifts to a strip around a candidate: a power of two that holds the width of an [`Around`].
const NARROW: usize = 16;

/// How points are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Counting {
    /// Each by itself: see [`Strips::add`].
    #[default]
    Each,
    /// By the means of four: see [`Strips::add_means`].
    Means,
}

impl Counting {
    /// Points to a summand.
    fn points(self) -> u32 {
        match self {
            Self::Each => 1,
            Self::Means => 4,
        }
    }

    fn add<const WIDTH: usize>(
        self,
        strips: &Strips<WIDTH>,
        isa: Isa,
        pixels: &[u32],
        sums: &mut [[u32; WIDTH]],
    ) {
        match self {
            Self::Each => strips.add(isa, pixels, sums),
            Self::Means => strips.add_means(isa, pixels, sums),
        }
    }
}

/// A search around a candidate: half widths in pixels and turns, and the step of a turn in fine steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Around {
    pub pixels: usize,
    pub turns: i32,
    pub step: i32,
}

impl Around {
    /// True when a strip holds its width.
    pub const fn fits(&self) -> bool {
        2 * self.pixels < NARROW
    }
}

/// Buffers of a search, and how it counts.
#[derive(Default)]
pub(super) struct Scan {
    pub isa: Isa,
    pub counting: Counting,
    /// For each shift of the last scan the best sum.
    pub best: Vec<u32>,
    /// Its turn, fine steps.
    turns: Vec<i32>,
    /// The points that are counted.
    points: Vec<BodyPoint>,
    pixels: Vec<u32>,
    sums: Vec<[u32; WIDE]>,
}

impl Scan {
    /// Takes points to be counted.
    pub fn take<'p>(&mut self, points: impl Iterator<Item = &'p WeightedPoint>) {
        self.points.clear();
        self.points.extend(points.map(WeightedPoint::position));
    }

    /// Sums of an image for every shift of its pixels and every `step`th turn, reduced to the best
    /// turn.
    pub fn scan(&mut self, question: &SearchQuestion, image: &ImageView, step: usize) {
        let width = width(question, image);
        let turns = question.lattice.turns.div_ceil(step) as i32;
        self.best.clear();
        self.best.resize(width * width, 0);
        self.turns.clear();
        self.turns.resize(width * width, 0);
        self.sums.resize(width, [0; WIDE]);
        let strips = Strips::<WIDE> { image: image.weights, stride: image.side, rows: width };
        for turn in -turns..=turns {
            let turn = turn * step as i32;
            let at = Pose2::new(0.0, 0.0, f64::from(turn) * question.lattice.yaw_step_rad);
            let points = self.points.iter().copied();
            let projection = question.projection(image, lag(question, image));
            projection.pixel_indices(self.isa, at, points, &mut self.pixels);
            for first in (0..width).step_by(WIDE) {
                self.sums.fill([0; WIDE]);
                self.counting.add(&strips, self.isa, &self.pixels, &mut self.sums);
                let columns = WIDE.min(width - first);
                for (row, sums) in self.sums.iter().enumerate() {
                    let here = row * width + first..row * width + first + columns;
                    let best = self.best[here.clone()].iter_mut().zip(&mut self.turns[here]);
                    for ((best, best_turn), sum) in best.zip(sums) {
                        *best_turn = if *sum > *best { turn } else { *best_turn };
                        *best = (*best).max(*sum);
                    }
                }
                self.pixels.iter_mut().for_each(|pixel| *pixel += WIDE as u32);
            }
        }
    }

    /// A shift of the last scan, with the best turn there. Its score is that of the search around it, which follows.
    pub fn candidate(&self, question: &SearchQuestion, image: &ImageView, index: usize) -> Candidate {
        let (lag, width) = (lag(question, image), width(question, image));
        let pixel_m = image.cells as f64 * CELL_M;
        let shift = |i: usize| (i as f64 - lag as f64) * pixel_m;
        let (row, column) = (index / width, index % width);
        let yaw_rad = f64::from(self.turns[index]) * question.lattice.yaw_step_rad;
        let correction = Pose2::new(shift(column), shift(row), yaw_rad);
        let at_edge = lag > 0 && [row, column].iter().any(|i| *i == 0 || *i == 2 * lag);
        Candidate { correction, score: 0.0, at_edge }
    }

    /// Moves candidates to the best hypotheses around them on a finer image, and sorts them.
    pub fn sharpen(
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
        let mut sums = [[0_u32; NARROW]; NARROW];
        let mut highest = 0;
        for turn in (-around.turns..=around.turns).map(|i| turn + i * around.step) {
            let at = Pose2::new(from.x_m, from.y_m, f64::from(turn) * yaw_step);
            let projection = question.projection(image, around.pixels);
            projection.pixel_indices(self.isa, at, self.points.iter().copied(), &mut self.pixels);
            sums.fill([0; NARROW]);
            self.counting.add(&strips, self.isa, &self.pixels, &mut sums[..width]);
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
        candidate.score = mean_weight(self.counting.points() * highest, self.points.len());
    }
}

/// Half width of a scan of an image, pixels.
fn lag(question: &SearchQuestion, image: &ImageView) -> usize {
    question.lattice.lag.div_ceil(image.cells)
}

/// Shifts of a scan of an image along one axis.
pub(super) fn width(question: &SearchQuestion, image: &ImageView) -> usize {
    2 * lag(question, image) + 1
}

/// An image with pixels twice as wide: means of 2 x 2, rounded up.
pub(super) fn halved<'a>(image: &ImageView, out: &'a mut Vec<u8>) -> ImageView<'a> {
    let side = image.side / 2;
    out.clear();
    out.resize(side * side + 2 * WIDE, 0);
    let (rows, _) = out.split_at_mut(side * side);
    for (row, two) in rows.chunks_exact_mut(side).zip(image.weights.chunks_exact(2 * image.side)) {
        let (south, north) = two.split_at(image.side);
        let (south, north) = (south.as_chunks().0, north.as_chunks().0);
        for ((mean, [a, b]), [c, d]) in row.iter_mut().zip(south).zip(north) {
            let sum: u16 = [a, b, c, d].into_iter().copied().map(u16::from).sum();
            *mean = sum.div_ceil(4) as u8;
        }
    }
    ImageView { square: image.square, cells: 2 * image.cells, side, weights: out }
}
