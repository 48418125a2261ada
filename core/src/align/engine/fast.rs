//! Coarse to fine: every hypothesis on a coarse image with a thinned batch, then the best few on finer
//! ones.
//!
//! Smoothing makes the map's weights wide hills; a hill that is highest on the fine image is among
//! the highest few on the coarse one. That is not proven but measured: see `BENCHMARKS.md`.

use std::cmp::Reverse;

use super::{Engine, Peak, Question};
use crate::align::simd::{Isa, Strips};
use crate::align::view::Shown;
use crate::geo::CELL_M;
use crate::pose::Pose2;

/// Shifts to a strip where all are scanned.
const WIDE: usize = 32;
/// Shifts to a strip around a hill.
const NARROW: usize = 16;
/// Points that a scan of all hypotheses looks at, at most, or little more.
const SCANNED: usize = 600;
/// Points that the search around a hill looks at, at most, or little more.
const SHARPENED: usize = 1000;
/// Hypotheses of a scan of the coarse image beyond which a coarser one is scanned before it.
const MANY: usize = 60_000;
/// Hills that are kept from the coarser image.
const KEPT: usize = 32;

/// The engine and its buffers.
#[derive(Default)]
pub struct Fast {
    isa: Isa,
    places: Vec<u32>,
    sums: Vec<[u32; WIDE]>,
    /// For each shift of a scan the best sum and its turn, fine steps.
    best: Vec<(u32, i32)>,
    coarser: Vec<u8>,
}

/// A search around a hill: half widths in pixels and turns, and the step of a turn in fine steps.
struct Around {
    pixels: usize,
    turns: i32,
    step: i32,
}

impl Engine for Fast {
    fn name(&self) -> &'static str {
        "fast"
    }

    fn search(&mut self, question: &Question, peaks: &mut Vec<Peak>) {
        let coarse = question.view.coarse();
        let shifts = 2 * question.lattice.lag.div_ceil(coarse.cells) + 1;
        if shifts * shifts * question.lattice.headings() > MANY {
            let mut image = std::mem::take(&mut self.coarser);
            let coarser = halved(&coarse, &mut image);
            self.scan(question, &coarser, 4);
            self.highest(question, &coarser, KEPT, peaks);
            self.sharpen(question, &coarse, &Around { pixels: 3, turns: 2, step: 2 }, peaks);
            self.coarser = image;
        } else {
            self.scan(question, &coarse, 2);
            self.highest(question, &coarse, question.search.peaks, peaks);
        }
        self.sharpen(question, &question.view.fine(), &Around { pixels: 5, turns: 1, step: 1 }, peaks);
        peaks.truncate(question.search.peaks);
    }
}

impl Fast {
    /// The engine on one instruction set.
    #[must_use]
    pub fn on(isa: Isa) -> Self {
        Self { isa, ..Self::default() }
    }

    /// Sums of an image for every shift of its pixels and every `step`th turn, reduced to the best
    /// turn.
    fn scan(&mut self, question: &Question, shown: &Shown, step: usize) {
        let lag = question.lattice.lag.div_ceil(shown.cells);
        let width = 2 * lag + 1;
        let turns = question.lattice.turns.div_ceil(step) as i32;
        self.best.clear();
        self.best.resize(width * width, (0, 0));
        self.sums.resize(width, [0; WIDE]);
        let strips = Strips::<WIDE> { image: shown.image, stride: shown.side, rows: width };
        let stride = (question.thinned.len() / SCANNED).max(1);
        for turn in -turns..=turns {
            let turn = turn * step as i32;
            let at = Pose2::new(0.0, 0.0, f64::from(turn) * question.lattice.yaw_step_rad);
            let points = question.thinned.iter().step_by(stride).map(|[x, y, _]| [*x, *y]);
            question.placing(*shown, lag).places(self.isa, at, points, &mut self.places);
            for first in (0..width).step_by(WIDE) {
                self.sums.fill([0; WIDE]);
                strips.add(self.isa, &self.places, &mut self.sums);
                let columns = WIDE.min(width - first);
                for (row, sums) in self.sums.iter().enumerate() {
                    let from = row * width + first;
                    for (best, sum) in self.best[from..from + columns].iter_mut().zip(sums) {
                        if *sum > best.0 {
                            *best = (*sum, turn);
                        }
                    }
                }
                self.places.iter_mut().for_each(|place| *place += WIDE as u32);
            }
        }
    }

    /// The highest shifts of the last scan, none within the separation of a higher one.
    fn highest(&mut self, question: &Question, shown: &Shown, most: usize, peaks: &mut Vec<Peak>) {
        let lag = question.lattice.lag.div_ceil(shown.cells);
        let width = 2 * lag + 1;
        let pixel_m = shown.cells as f64 * CELL_M;
        let separation = (question.search.separation_m / pixel_m).powi(2);
        let reach = separation.sqrt().ceil() as usize;
        peaks.clear();
        while peaks.len() < most {
            let top = self.best.iter().enumerate().max_by_key(|(i, (sum, _))| (*sum, Reverse(*i)));
            let Some((index, &(sum, turn))) = top.filter(|(_, (sum, _))| *sum > 0) else { break };
            let (row, column) = (index / width, index % width);
            for other_row in row.saturating_sub(reach)..(row + reach + 1).min(width) {
                for other_column in column.saturating_sub(reach)..(column + reach + 1).min(width) {
                    let (dr, dc) = (other_row.abs_diff(row), other_column.abs_diff(column));
                    if ((dr * dr + dc * dc) as f64) < separation {
                        self.best[other_row * width + other_column].0 = 0;
                    }
                }
            }
            let shift = |i: usize| (i as f64 - lag as f64) * pixel_m;
            let yaw_rad = f64::from(turn) * question.lattice.yaw_step_rad;
            let at_edge = lag > 0 && [row, column].iter().any(|i| *i == 0 || *i == 2 * lag);
            peaks.push(Peak {
                correction: Pose2::new(shift(column), shift(row), yaw_rad),
                score: sum,
                at_edge,
            });
        }
    }

    /// Moves hills to the best hypotheses around them on a finer image, and sorts them.
    fn sharpen(&mut self, question: &Question, shown: &Shown, around: &Around, peaks: &mut [Peak]) {
        for peak in peaks.iter_mut() {
            self.sharpen_one(question, shown, around, peak);
        }
        peaks.sort_by_key(|peak| Reverse(peak.score));
    }

    fn sharpen_one(&mut self, question: &Question, shown: &Shown, around: &Around, peak: &mut Peak) {
        let width = 2 * around.pixels + 1;
        let strips = Strips::<NARROW> { image: shown.image, stride: shown.side, rows: width };
        let (from, yaw_step) = (peak.correction, question.lattice.yaw_step_rad);
        let pixel_m = shown.cells as f64 * CELL_M;
        let turn = (from.yaw_rad / yaw_step).round() as i32;
        let stride = question.thinned.len().div_ceil(SHARPENED).max(1);
        let mut sums = [[0_u32; NARROW]; NARROW];
        peak.score = 0;
        for turn in (-around.turns..=around.turns).map(|i| turn + i * around.step) {
            let at = Pose2::new(from.x_m, from.y_m, f64::from(turn) * yaw_step);
            let points = question.thinned.iter().step_by(stride).map(|[x, y, _]| [*x, *y]);
            question.placing(*shown, around.pixels).places(self.isa, at, points, &mut self.places);
            sums.fill([0; NARROW]);
            strips.add(self.isa, &self.places, &mut sums[..width]);
            for (row, sums) in sums[..width].iter().enumerate() {
                for (column, sum) in sums[..width].iter().enumerate() {
                    if *sum > peak.score {
                        let shift = |i: usize| (i as f64 - around.pixels as f64) * pixel_m;
                        let yaw_rad = f64::from(turn) * yaw_step;
                        peak.correction =
                            Pose2::new(from.x_m + shift(column), from.y_m + shift(row), yaw_rad);
                        peak.score = *sum;
                    }
                }
            }
        }
    }
}

/// An image with pixels twice as wide: means of 2 x 2, rounded up.
fn halved<'a>(shown: &Shown, out: &'a mut Vec<u8>) -> Shown<'a> {
    let side = shown.side / 2;
    out.clear();
    out.resize(side * side + 2 * WIDE, 0);
    for y in 0..side {
        for x in 0..side {
            let at = 2 * y * shown.side + 2 * x;
            let four = [at, at + 1, at + shown.side, at + shown.side + 1];
            let sum: u16 = four.iter().map(|i| u16::from(shown.image[*i])).sum();
            out[y * side + x] = sum.div_ceil(4) as u8;
        }
    }
    Shown { frame: shown.frame, cells: 2 * shown.cells, side, image: out }
}
