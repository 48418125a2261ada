//! Engines: ways to find the hills of the correlation.

pub mod fast;

use super::view::MapView;
use super::weights::COARSE;
use super::{Prior, Search};
use crate::batch::Batch;
use crate::geo::CELL_M;
use crate::pose::Pose2;

/// A hill of the correlation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// The hypothesis: metres east and north of the prior, radians.
    pub correction: Pose2,
    /// Its sum of weights; comparable within one engine only.
    pub score: u32,
    /// True when it lies on the edge of the search.
    pub at_edge: bool,
}

/// The hypotheses to be searched: shifts of cells and turns of steps around the prior.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lattice {
    /// Half width of the shifts, cells (fastGlobalAlign l. 6).
    pub lag: usize,
    /// Half width of the headings, steps (fastGlobalAlign l. 7).
    pub turns: usize,
}

impl Lattice {
    /// The hypotheses within the search's sigmas of a prior.
    #[must_use]
    pub fn of(prior: &Prior, search: &Search) -> Self {
        let steps = |sigma: f64, step: f64| (search.sigmas * sigma / step).ceil() as usize;
        Self {
            lag: steps(prior.sigma_position_m, CELL_M),
            turns: steps(prior.sigma_yaw_rad, search.yaw_step_rad),
        }
    }
}

/// What an engine is asked.
#[derive(Clone, Copy)]
pub struct Question<'a> {
    /// The map.
    pub view: &'a MapView,
    /// The batch.
    pub batch: &'a Batch,
    /// Where it is believed to be.
    pub prior: &'a Prior,
    /// How to search.
    pub search: &'a Search,
    /// The hypotheses.
    pub lattice: Lattice,
}

impl Question<'_> {
    /// For each point, turned by `turn` steps: the index of its cell in the image with cells of
    /// `cells` map cells, moved south-west by `lag` of them (columns, rows). Points too near the
    /// image's border are left out.
    fn places(&self, points: &[[f32; 3]], turn: i32, cells: usize, lag: [usize; 2], out: &mut Vec<u32>) {
        self.place(points, Pose2::new(0.0, 0.0, f64::from(turn) * self.search.yaw_step_rad), cells, lag, out);
    }

    /// The same on the fine image, around a correction's shift.
    fn places_at(&self, points: &[[f32; 3]], at: Pose2, turn: i32, lag: usize, out: &mut Vec<u32>) {
        let yaw_rad = f64::from(turn) * self.search.yaw_step_rad;
        self.place(points, Pose2::new(at.x_m, at.y_m, yaw_rad), 1, [lag, lag], out);
    }

    fn place(&self, points: &[[f32; 3]], at: Pose2, cells: usize, lag: [usize; 2], out: &mut Vec<u32>) {
        let (frame, prior) = (self.view.frame(), self.prior);
        let [x0, y0] = frame.to_cells([prior.pose.x_m + at.x_m, prior.pose.y_m + at.y_m]);
        let unit = 1.0 / cells as f64;
        let (x0, y0) = ((x0 * unit) as f32, (y0 * unit) as f32);
        let (s, c) = (prior.pose.yaw_rad + at.yaw_rad).sin_cos();
        let per_metre = prior.scale / CELL_M * unit;
        let (s, c) = ((s * per_metre) as f32, (c * per_metre) as f32);
        let side = if cells == COARSE { self.view.coarse_side() } else { frame.side };
        let (low_x, low_y) = (lag[0] as f32, lag[1] as f32);
        let (high_x, high_y) = ((side - lag[0]) as f32, (side - lag[1]) as f32);
        out.clear();
        out.extend(points.iter().filter_map(|[px, py, _]| {
            let (x, y) = (x0 + c * px - s * py, y0 + s * px + c * py);
            let inside = x >= low_x && x < high_x && y >= low_y && y < high_y;
            inside.then(|| (y as u32 - lag[1] as u32) * side as u32 + x as u32 - lag[0] as u32)
        }));
    }
}
