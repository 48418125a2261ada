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
mod cells;
pub mod climb;
pub mod correlation;
mod fft2;
pub mod image;
mod raster;
pub mod score;
pub mod simd;
pub mod thin;
pub mod view;
pub mod weights;

pub use correlation::{Correlation, Lattice};

use crate::batch::Batch;
use crate::pose::Pose2;
use cells::places;
use image::MapImage;
use raster::Raster;
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
}

impl Default for Search {
    fn default() -> Self {
        Self {
            sigmas: 3.0,
            yaw_step_rad: 1_f64.to_radians(),
            extent_m: 50.0,
            peaks: 5,
            separation_m: 1.0,
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
    let offset = lattice.lag * shown.side + lattice.lag;
    let mut values = vec![0.0; lattice.headings() * lattice.plane()];
    // l. 8
    for (heading, values) in values.chunks_exact_mut(lattice.plane()).enumerate() {
        // l. 9
        let turned = Pose2::new(0.0, 0.0, lattice.turn_rad(heading));
        // l. 3-5 and 10: the batch's points, turned by the hypothesis, become its occupancy grid.
        let points = batch.points.iter().copied();
        places(&shown, prior, turned, points, search.extent_m, lattice.lag, &mut workspace.places);
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
