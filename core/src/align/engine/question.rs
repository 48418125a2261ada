//! What an engine is asked.

use super::Candidate;
use crate::align::correlation::Lattice;
use crate::align::projection::{DistinctPixels, Projection};
use crate::align::simd::Isa;
use crate::align::view::{ImageView, MapView};
use crate::align::weights::STEPS;
use crate::align::{Prior, Search};
use crate::batch::Batch;
use crate::point::WeightedPoint;
use crate::pose::Pose2;

/// Where in the search around the prior is the batch on the map?
#[derive(Clone, Copy)]
pub struct SearchQuestion<'a> {
    /// The map.
    pub view: &'a MapView,
    /// The batch.
    pub batch: &'a Batch,
    /// The batch, thinned (see [`crate::align::thin`]).
    pub thinned: &'a [WeightedPoint],
    /// The rough pose.
    pub prior: &'a Prior,
    /// How to search.
    pub search: &'a Search,
    /// The hypotheses: those within the search's sigmas of the prior.
    pub lattice: Lattice,
}

impl<'a> SearchQuestion<'a> {
    /// A question over all hypotheses within the search's sigmas of the prior.
    #[must_use]
    pub fn new(
        view: &'a MapView,
        batch: &'a Batch,
        thinned: &'a [WeightedPoint],
        prior: &'a Prior,
        search: &'a Search,
    ) -> Self {
        Self { view, batch, thinned, prior, search, lattice: Lattice::of(prior, search) }
    }

    /// The occupied cells of the batch under a heading: indices in the fine image, moved by the lag.
    pub(super) fn occupied(
        &self,
        isa: Isa,
        heading: usize,
        distinct: &mut DistinctPixels,
        out: &mut Vec<u32>,
    ) {
        let turned = Pose2::new(0.0, 0.0, self.lattice.turn_rad(heading));
        let projection = self.projection(&self.view.fine(), self.lattice.lag);
        projection.pixel_indices(isa, turned, self.batch.points.iter().copied(), out);
        distinct.retain(out);
    }

    /// From its points to one of the view's images.
    pub(super) fn projection(&self, image: &ImageView, lag: usize) -> Projection<'a> {
        Projection::onto(image, self.prior, self.search.extent_m, lag)
    }

    /// The sum of weights below cells that are shifted to a row and a column of the lattice.
    pub(super) fn sum(&self, occupied: &[u32], row: usize, column: usize) -> u32 {
        let image = self.view.fine();
        let shift = row * image.side + column;
        occupied.iter().map(|pixel| u32::from(image.weights[*pixel as usize + shift])).sum()
    }

    /// A hypothesis with its sum of weights; `cells` are those of the batch under the prior's heading.
    pub(super) fn candidate(&self, index: usize, sum: u32, cells: usize) -> Candidate {
        Candidate {
            correction: self.lattice.hypothesis(index),
            score: mean_weight(sum, cells),
            at_edge: self.lattice.is_at_edge(index),
        }
    }
}

/// A sum of weights over so many points as a score.
pub(super) fn mean_weight(sum: u32, points: usize) -> f64 {
    f64::from(sum) / (f64::from(STEPS) * points.max(1) as f64)
}
