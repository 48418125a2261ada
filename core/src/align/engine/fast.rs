//! Coarse to fine: every hypothesis on a coarse image with a thinned batch, then the best few on the
//! fine one.
//!
//! Smoothing makes the map's weights wide hills; a hill that is highest on the fine image is among
//! the highest few on the coarse one. That is not proven but measured: see `BENCHMARKS.md`.

use std::cmp::Reverse;

use super::{Engine, Peak, Question};
use crate::align::cells::places;
use crate::align::simd::{Isa, Strips};
use crate::align::weights::COARSE;
use crate::geo::CELL_M;
use crate::pose::Pose2;

/// Shifts to a strip of the coarse image.
const WIDE: usize = 32;
/// Shifts to a strip of the fine image.
const NARROW: usize = 16;
/// Half width of the search around a coarse peak, fine cells.
const AROUND: usize = 5;
/// Coarse steps of the heading, fine steps.
const COARSE_TURN: usize = 2;

/// The engine and its buffers.
pub struct Fast {
    isa: Isa,
    places: Vec<u32>,
    sums: Vec<[u32; WIDE]>,
    /// For each coarse shift the best sum and its heading.
    best: Vec<(u32, i32)>,
}

impl Default for Fast {
    fn default() -> Self {
        Self::on(Isa::best())
    }
}

impl Fast {
    /// The engine on one instruction set.
    #[must_use]
    pub fn on(isa: Isa) -> Self {
        Self {
            isa,
            places: Vec::new(),
            sums: Vec::new(),
            best: Vec::new(),
        }
    }
}

impl Engine for Fast {
    fn name(&self) -> &'static str {
        "fast"
    }

    fn search(&mut self, question: &Question, peaks: &mut Vec<Peak>) {
        let lag = question.lattice.lag.div_ceil(COARSE);
        self.coarse(question, lag);
        self.highest(question, lag, peaks);
        for peak in peaks.iter_mut() {
            self.sharpen(question, peak);
        }
        peaks.sort_by_key(|peak| Reverse(peak.score));
    }
}

impl Fast {
    /// Sums of the coarse image for every coarse shift and heading, reduced to the best heading.
    fn coarse(&mut self, question: &Question, lag: usize) {
        let width = 2 * lag + 1;
        let shown = question.view.coarse();
        let turns = question.lattice.turns.div_ceil(COARSE_TURN) as i32;
        self.best.clear();
        self.best.resize(width * width, (0, 0));
        self.sums.resize(width, [0; WIDE]);
        let strips = Strips::<WIDE> { image: shown.image, stride: shown.side, rows: width };
        for turn in -turns..=turns {
            let turn = turn * COARSE_TURN as i32;
            let at = Pose2::new(0.0, 0.0, f64::from(turn) * question.lattice.yaw_step_rad);
            let points = question.thinned.iter().map(|[x, y, _]| [*x, *y]);
            places(&shown, question.prior, at, points, question.search.extent_m, lag, &mut self.places);
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

    /// The highest coarse shifts, none within the separation of a higher one.
    fn highest(&mut self, question: &Question, lag: usize, peaks: &mut Vec<Peak>) {
        let width = 2 * lag + 1;
        let coarse_m = COARSE as f64 * CELL_M;
        let separation = (question.search.separation_m / coarse_m).powi(2);
        peaks.clear();
        while peaks.len() < question.search.peaks {
            let top = self.best.iter().enumerate().max_by_key(|(i, (sum, _))| (*sum, Reverse(*i)));
            let Some((index, &(sum, turn))) = top.filter(|(_, (sum, _))| *sum > 0) else { break };
            let (row, column) = (index / width, index % width);
            for (other, best) in self.best.iter_mut().enumerate() {
                let (dr, dc) = ((other / width).abs_diff(row), (other % width).abs_diff(column));
                if ((dr * dr + dc * dc) as f64) < separation {
                    best.0 = 0;
                }
            }
            let shift = |i: usize| (i as f64 - lag as f64) * coarse_m;
            let yaw_rad = f64::from(turn) * question.lattice.yaw_step_rad;
            let at_edge = lag > 0 && [row, column].iter().any(|i| *i == 0 || *i == 2 * lag);
            peaks.push(Peak { correction: Pose2::new(shift(column), shift(row), yaw_rad), score: sum, at_edge });
        }
    }

    /// Moves a coarse peak to the best fine hypothesis around it.
    fn sharpen(&mut self, question: &Question, peak: &mut Peak) {
        let shown = question.view.fine();
        let strips = Strips::<NARROW> { image: shown.image, stride: shown.side, rows: 2 * AROUND + 1 };
        let (from, step) = (peak.correction, question.lattice.yaw_step_rad);
        let coarse_turn = (from.yaw_rad / step).round() as i32;
        let mut sums = [[0_u32; NARROW]; 2 * AROUND + 1];
        peak.score = 0;
        for turn in coarse_turn - 1..=coarse_turn + 1 {
            let at = Pose2::new(from.x_m, from.y_m, f64::from(turn) * step);
            let points = question.thinned.iter().map(|[x, y, _]| [*x, *y]);
            places(&shown, question.prior, at, points, question.search.extent_m, AROUND, &mut self.places);
            sums.fill([0; NARROW]);
            strips.add(self.isa, &self.places, &mut sums);
            for (row, sums) in sums.iter().enumerate() {
                for (column, sum) in sums[..=2 * AROUND].iter().enumerate() {
                    if *sum > peak.score {
                        let shift = |i: usize| (i as f64 - AROUND as f64) * CELL_M;
                        let yaw_rad = f64::from(turn) * step;
                        peak.correction = Pose2::new(from.x_m + shift(column), from.y_m + shift(row), yaw_rad);
                        peak.score = *sum;
                    }
                }
            }
        }
    }
}
