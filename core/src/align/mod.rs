//! Where is the batch on the map? The paper's algorithm, and what makes its answer better and
//! honest.
//!
//! 1. [`PreparedMap`]: the window's occupancy and its spectrum, once for all requests around here.
//! 2. [`fast_global_align`]: the correlation of map and batch for every shift and heading within
//!    three sigma of the prior: the global optimum, not the nearest one.
//! 3. [`peaks`]: the highest distinct maxima of that volume.
//! 4. [`refine`]: each is climbed on a smoothed map with the unrounded points, below a cell and
//!    below a heading step; the best one is the answer, the others are its alternatives.
//! 5. [`verdict`]: may the answer be used, and how large can its error be?

pub mod engine;
pub mod fft;
pub mod peaks;
mod prepared;
pub mod raster;
pub mod climb;
pub mod refine;
pub mod score;
pub mod simd;
mod surface;
pub mod thin;
pub mod verdict;
pub mod view;
pub mod weights;

pub use prepared::PreparedMap;
pub use surface::Surface;

use crate::batch::Batch;
use crate::evidence::InverseSensorModel;
use crate::pose::Pose2;
use raster::Raster;
use refine::{Refined, Score};
use verdict::{Case, Integrity, Verdict};

/// How to search. The defaults are the paper's (Sec. "Test procedure").
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    /// The search covers this many sigmas of the prior in every direction.
    pub sigmas: f64,
    /// Step of the heading, radians. The step of the position is a cell, 0.1 m.
    pub yaw_step_rad: f64,
    /// Detections farther than this from the body at the reference time are left out, metres: the
    /// window reaches no farther. At speed that is much of what the oldest scans saw behind.
    pub extent_m: f64,
    /// Peaks that are refined, at most.
    pub peaks: usize,
    /// Two peaks nearer than this are one, metres.
    pub separation_m: f64,
    /// The inverse sensor model of map and batch.
    pub model: InverseSensorModel,
}

impl Default for Search {
    fn default() -> Self {
        Self {
            sigmas: 3.0,
            yaw_step_rad: 1_f64.to_radians(),
            extent_m: 50.0,
            peaks: 5,
            separation_m: 1.0,
            model: InverseSensorModel::default(),
        }
    }
}

/// A rough pose of the body on the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Map metres and radians from grid east.
    pub pose: Pose2,
    /// One-sigma error of the position along each axis, metres.
    pub sigma_position_m: f64,
    /// One-sigma error of the heading, radians.
    pub sigma_yaw_rad: f64,
    /// Map metres per ground metre at this place.
    pub scale: f64,
}

/// The correlation of map and batch for every hypothesis.
#[derive(Debug, Clone, PartialEq)]
pub struct Correlation {
    /// Half width of the shifts, cells.
    pub lag: usize,
    /// Half width of the headings, steps.
    pub turns: usize,
    /// Step of the headings, radians.
    pub yaw_step_rad: f64,
    /// `R[i, dy, dx]`: by heading from -turns to turns, then by row from -lag to lag, then by
    /// column.
    pub values: Vec<f32>,
}

/// Correlates a batch with the map for every shift and heading within the search (paper,
/// alg. fastGlobalAlign), on exact rotations of the points instead of a rotated spectrum.
#[must_use]
pub fn fast_global_align(
    map: &PreparedMap,
    batch: &Batch,
    prior: &Prior,
    search: &Search,
    workspace: &mut Workspace,
) -> Correlation {
    // fastGlobalAlign l. 1-2: D_m and its spectrum come with the prepared map.
    let spectrum = map.spectrum();
    // l. 6-7
    let lag = shift_cells(prior, search);
    let turns = heading_steps(prior, search);
    let plane = (2 * lag + 1).pow(2);
    let mut values = vec![0.0; (2 * turns + 1) * plane];
    // l. 8
    for (i, values) in values.chunks_exact_mut(plane).enumerate() {
        // l. 9
        let turn_rad = (i as f64 - turns as f64) * search.yaw_step_rad;
        // l. 3-5 and 10: the batch's points, turned by the hypothesis, become its occupancy grid.
        let raster = &mut workspace.raster;
        raster.draw(map.frame(), batch, prior, turn_rad, search, lag);
        // l. 11
        map.plans().correlate(spectrum, raster.image(), lag, &mut workspace.fft, values);
    }
    Correlation { lag, turns, yaw_step_rad: search.yaw_step_rad, values }
}

/// Half width of the shifts, cells (fastGlobalAlign l. 6).
fn shift_cells(prior: &Prior, search: &Search) -> usize {
    (search.sigmas * prior.sigma_position_m / crate::geo::CELL_M).ceil() as usize
}

/// Half width of the headings, steps (fastGlobalAlign l. 7).
fn heading_steps(prior: &Prior, search: &Search) -> usize {
    (search.sigmas * prior.sigma_yaw_rad / search.yaw_step_rad).ceil() as usize
}

/// Points that show the way up a peak.
const CLIMBING_POINTS: usize = 1500;

/// Buffers that one thread reuses from request to request.
#[derive(Default)]
pub struct Workspace {
    raster: Raster,
    fft: fft::Workspace,
}

/// The answer with its diagnostics.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// Corrected pose of the body: map metres, radians from grid east.
    pub pose: Pose2,
    /// Corrected pose minus prior, component by component: metres east and north, radians.
    pub correction: Pose2,
    /// Covariance of (east m, north m, yaw rad).
    pub covariance: [[f64; 3]; 3],
    /// Other poses that explain the batch, as corrections with their score relative to the
    /// answer's, best first.
    pub alternatives: Vec<(Pose2, f64)>,
    /// Mean log weight of the batch's points on the smoothed map, above that of a random shift.
    pub score: f64,
    /// Detections that were correlated.
    pub points_used: usize,
    /// Occupied cells of the batch.
    pub batch_cells: usize,
    /// Share of them that lie on mapped structure at the answer.
    pub matched_fraction: f64,
    /// Share of them that lie in a tile the map has.
    pub coverage: f64,
    /// Half width of the search: metres and radians.
    pub searched: (f64, f64),
    /// May it be used?
    pub verdict: Verdict,
}

/// Finds the pose of a batch on the map: search, refinement, verdict.
#[must_use]
pub fn align(
    map: &PreparedMap,
    batch: &Batch,
    prior: &Prior,
    search: &Search,
    integrity: &Integrity,
    workspace: &mut Workspace,
) -> Alignment {
    let correlation = fast_global_align(map, batch, prior, search, workspace);
    let points = raster::points_in_reach(batch, search);
    let thinned: Vec<_> = points.iter().step_by(points.len() / CLIMBING_POINTS + 1).copied().collect();
    let full = Score::new(map.surface(), map.frame(), &points, prior);
    let thinned = Score::new(map.surface(), map.frame(), &thinned, prior);
    let peaks = peaks::highest(&correlation, search);
    let mut found: Vec<Refined> = peaks.iter().map(|peak| peak.climbed(&thinned, &full)).collect();
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    if let Some(best) = found.first_mut() {
        *best = refine::climb(&full, &best.correction, best.at_edge);
    }
    let batch_cells = workspace.raster.cells();
    let case = Case {
        map,
        batch,
        prior,
        search,
        correlation: &correlation,
        points: &points,
        found: &found,
        batch_cells,
    };
    case.judge(integrity)
}
