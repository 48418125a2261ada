//! Where is the batch on the map? The paper's algorithm, and what makes its answer better, faster and
//! honest.
//!
//! The paper's algorithm is [`fast_global_align`]: the correlation of map and batch for every shift and
//! heading of a search, and its maximum. An answer takes more than that:
//!
//! 1. [`weights`]: tiles become images of weights, once a version; [`view`] assembles those around a prior.
//! 2. [`thin`]: the batch becomes one point a block.
//! 3. [`engine`]: the highest candidates of the correlation among all shifts and headings within three
//!    sigma of the prior: the global optimum, not the nearest one.
//! 4. [`refine()`](refine::refine): each candidate is refined with the unrounded points, below a cell and
//!    below a heading step. [`drift`]: for the best one odometry's drift is estimated along with the pose.
//! 5. [`answer`], [`verdict`]: the covariance, whether the answer may be used, and how large its error can be.
//!
//! [`pipeline`] is 1 to 4 without the drift: localizing ([`Aligner`], which adds the drift and 5), vetting
//! ([`crate::vetting::matching::PartMatcher`]) and [`localizability`], which asks the map alone what a fix can be
//! expected to be, are three ways to use it.

mod aligner;
mod alternatives;
pub mod answer;
pub mod combine;
pub mod correlation;
pub mod drift;
pub mod engine;
pub mod fft;
mod fft2;
pub mod image;
pub mod localizability;
pub mod objects;
mod occupancy_grid;
mod packed;
pub mod pipeline;
mod projection;
pub mod ranking;
pub mod refine;
pub mod rivals;
pub mod score;
mod search;
pub mod simd;
mod smoothing;
pub mod thin;
pub mod verdict;
pub mod view;
pub mod weights;

pub use aligner::{Aligner, Task};
pub use alternatives::Alternatives;
pub use answer::Alignment;
pub use correlation::{Correlation, Lattice};
pub use engine::EngineKind;
pub use search::{Prior, Search};

use crate::batch::Batch;
use crate::pose::Pose2;
use image::MapImage;
use occupancy_grid::OccupancyGrid;
use projection::Projection;
use simd::Isa;

/// Finds the pose of a batch on a map, and the correlation it is the maximum of: the paper's algorithm
/// fastGlobalAlign, by its line numbers.
///
/// Lines 4 and 5 come in the loop, after line 10: the batch's points are turned instead of its spectrum. A
/// turned spectrum is interpolated; turned points are exact, and drawing them costs little beside the transform.
#[must_use]
pub fn fast_global_align(
    map: &MapImage,
    batch: &Batch,
    prior: &Prior,
    search: &Search,
    workspace: &mut CorrelationWorkspace,
) -> (Pose2, Correlation) {
    let CorrelationWorkspace { pixels, grid, fft } = workspace;
    let square = map.square(); // l. 1: the grid of the map's points, drawn once for all batches
    let map_spectrum = map.spectrum(); // l. 2: its spectrum
    let points = &batch.points; // l. 3: organised by odometry, in `Batch::organise`
    let lattice = Lattice::of(prior, search);
    let n = lattice.lag; // l. 6: half width of the shifts
    let m = lattice.turns; // l. 7: half width of the headings
    let projection = Projection::of_cells(square, prior, search.extent_m, n);
    let mut values = vec![0.0; lattice.headings() * lattice.plane()];
    // l. 8: for each heading
    for (i, shifts) in (0..=2 * m).zip(values.chunks_exact_mut(lattice.plane())) {
        let turn = Pose2::new(0.0, 0.0, lattice.turn_rad(i)); // l. 9: by how much
        projection.pixel_indices(Isa::best(), turn, points.iter().copied(), pixels); // l. 10: points, turned
        grid.draw(square.side, pixels, n * square.side + n, map.cell_values()); // l. 4: their grid
        // l. 5: its spectrum; l. 11: times the map's, transformed back, shifts of -n to n.
        map.plans().correlate(map_spectrum, grid.image(), n, fft, shifts);
    } // l. 12
    let correlation = Correlation { lattice, values };
    let best = lattice.hypothesis(correlation.argmax()); // l. 13: the maximum
    (prior.corrected(&best), correlation)
}

/// Buffers of [`fast_global_align`] that one thread reuses from request to request.
#[derive(Default)]
pub struct CorrelationWorkspace {
    pixels: Vec<u32>,
    grid: OccupancyGrid,
    fft: fft::FftWorkspace,
}
