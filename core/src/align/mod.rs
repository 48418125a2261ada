//! Where is the batch on the map? The paper's algorithm, and what makes its answer better, faster and
//! honest.
//!
//! 1. [`weights`]: tiles become images of weights, once a version; [`view`] shows those around a prior.
//! 2. [`engine`]: the highest hills of the correlation of map and batch among all shifts and headings
//!    within three sigma of the prior: the global optimum, not the nearest one.
//!    [`fast_global_align`] is the paper's way to them.
//! 3. [`climb`]: each hill is climbed with the unrounded points, below a cell and below a heading
//!    step; on the best one odometry's drift is estimated along with the pose.
//! 4. [`verdict`]: may the answer be used, and how large can its error be?
//!
//! [`Aligner`] runs the four for one request after the other. [`localizability`] asks the map alone what
//! they would answer at a place.

mod aligner;
mod alternatives;
mod cells;
pub mod climb;
pub mod combine;
pub mod correlation;
pub mod engine;
pub mod fft;
mod fft2;
pub mod image;
pub mod localizability;
mod raster;
pub mod score;
pub mod simd;
mod smoothing;
pub mod thin;
pub mod verdict;
pub mod view;
pub mod weights;

pub use aligner::{Aligner, EngineKind, Task};
pub use alternatives::Alternatives;
pub use correlation::{Correlation, Lattice};

use crate::batch::Batch;
use crate::pose::{Pose2, wrap_angle};
use cells::Placing;
use climb::DriftPrior;
use image::MapImage;
use raster::Raster;
use simd::Isa;
use verdict::Verdict;
use view::Shown;

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
    /// What odometry may have drifted over a batch.
    pub drift: DriftPrior,
}

impl Default for Search {
    fn default() -> Self {
        Self {
            sigmas: 3.0,
            yaw_step_rad: 1_f64.to_radians(),
            extent_m: 50.0,
            peaks: 5,
            separation_m: 1.0,
            drift: DriftPrior::default(),
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

impl Prior {
    /// The pose corrected by metres east and north and radians.
    #[must_use]
    pub fn corrected(&self, by: &Pose2) -> Pose2 {
        Pose2::new(self.pose.x_m + by.x_m, self.pose.y_m + by.y_m, wrap_angle(self.pose.yaw_rad + by.yaw_rad))
    }
}

/// Correlates a batch with a map for every hypothesis of a lattice (paper, alg. fastGlobalAlign), on
/// exact turns of the points instead of a turned spectrum.
#[must_use]
pub fn fast_global_align(
    map: &MapImage,
    batch: &Batch,
    prior: &Prior,
    search: &Search,
    lattice: &Lattice,
    workspace: &mut Workspace,
) -> Correlation {
    // fastGlobalAlign l. 1-2: D_m and its spectrum come with the map's image.
    let shown = Shown { frame: map.frame(), cells: 1, side: map.frame().side, image: &[] };
    let placing = Placing { image: shown, prior, reach_m: search.extent_m, lag: lattice.lag };
    let offset = lattice.lag * shown.side + lattice.lag;
    let mut values = vec![0.0; lattice.headings() * lattice.plane()];
    // l. 8
    for (heading, values) in values.chunks_exact_mut(lattice.plane()).enumerate() {
        // l. 9
        let turned = Pose2::new(0.0, 0.0, lattice.turn_rad(heading));
        // l. 3-5 and 10: the batch's points, turned by the hypothesis, become its occupancy grid.
        let points = batch.points.iter().copied();
        placing.places(Isa::best(), turned, points, &mut workspace.places);
        workspace.raster.draw(shown.side, &workspace.places, offset, map.cell_values());
        // l. 11
        let image = workspace.raster.image();
        map.plans().correlate(map.spectrum(), image, lattice.lag, &mut workspace.fft, values);
    }
    Correlation { lattice: *lattice, values }
}

/// Buffers that one thread reuses from request to request.
#[derive(Default)]
pub struct Workspace {
    places: Vec<u32>,
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
    /// Other poses that explain the batch.
    pub alternatives: Alternatives,
    /// Mean log weight of the batch's points on the smoothed map, above that of a random shift.
    pub score: f64,
    /// The answer's mean log weight relative to that of a random shift.
    pub contrast: f64,
    /// Log-likelihood by which the answer exceeds the best pose elsewhere, nats.
    pub margin: f64,
    /// Detections that were used.
    pub points_used: usize,
    /// Blocks that the batch was thinned to.
    pub thinned_points: usize,
    /// Share of them that lie on mapped structure at the answer.
    pub matched_fraction: f64,
    /// Share of them that lie in a tile the map has.
    pub coverage: f64,
    /// Half width of the search: metres and radians.
    pub searched: (f64, f64),
    /// May it be used?
    pub verdict: Verdict,
}
