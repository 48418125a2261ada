//! Engines: ways to find the maximum of the correlation.
//!
//! All are asked the same [`Question`]. The exact ones maximise the same discretised correlation, the
//! sum of the map's weights below the batch's occupied cells, and so find the same maximum; of equal
//! sums the first in the lattice's order.
//!
//! - [`Fast`]: coarse to fine, what the service asks; not exact, see its measured miss rate.
//! - [`Bounded`]: exact, by bounds that rule out all but a few shifts.
//! - [`Fft`]: exact, every hypothesis, at a cost that does not grow with the batch.
//! - [`Reference`]: exact, double precision, no shortcut: what the others are measured by.

mod bounded;
mod fast;
mod fft;
mod reference;

pub use bounded::Bounded;
pub use fast::Fast;
pub use fft::Fft;
pub use reference::Reference;

use super::cells::{Once, Placing};
use super::correlation::Lattice;
use super::simd::Isa;
use super::view::{MapView, Shown};
use super::{Prior, Search};
use crate::batch::Batch;
use crate::pose::Pose2;

/// A hill of the correlation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// The hypothesis: metres east and north of the prior, radians.
    pub correction: Pose2,
    /// Its sum of weights; comparable within one answer only.
    pub score: u32,
    /// True when it lies on the edge of the search.
    pub at_edge: bool,
}

/// What an engine is asked.
#[derive(Clone, Copy)]
pub struct Question<'a> {
    /// The map.
    pub view: &'a MapView,
    /// The batch.
    pub batch: &'a Batch,
    /// The batch, thinned (see [`crate::align::thin`]): ground metres in the body's frame, and what a
    /// point counts for.
    pub thinned: &'a [[f32; 3]],
    /// Where it is believed to be.
    pub prior: &'a Prior,
    /// How to search.
    pub search: &'a Search,
    /// The hypotheses.
    pub lattice: Lattice,
}

/// A way to find the maximum of the correlation, with its buffers.
pub trait Engine: Send {
    /// Its name in tables and configuration.
    fn name(&self) -> &'static str;

    /// Writes the highest hills, best first: at least one, at most the search's number of them.
    fn search(&mut self, question: &Question, peaks: &mut Vec<Peak>);
}

impl Question<'_> {
    /// The occupied cells of the batch under a heading: indices in the fine image, moved by the lag.
    fn occupied(&self, isa: Isa, heading: usize, once: &mut Once, out: &mut Vec<u32>) {
        let at = Pose2::new(0.0, 0.0, self.lattice.turn_rad(heading));
        let placing = self.placing(self.view.fine(), self.lattice.lag);
        placing.places(isa, at, self.batch.points.iter().copied(), out);
        once.retain(out);
    }

    /// Of its points on one of the view's images.
    fn placing<'b>(&'b self, image: Shown<'b>, lag: usize) -> Placing<'b> {
        Placing { image, prior: self.prior, reach_m: self.search.extent_m, lag }
    }

    /// The sum of weights below cells that are shifted to a row and a column of the lattice.
    fn sum(&self, occupied: &[u32], row: usize, column: usize) -> u32 {
        let shown = self.view.fine();
        let shift = row * shown.side + column;
        occupied.iter().map(|place| u32::from(shown.image[*place as usize + shift])).sum()
    }

    fn peak(&self, index: usize, score: u32) -> Peak {
        Peak { correction: self.lattice.hypothesis(index), score, at_edge: self.lattice.is_at_edge(index) }
    }
}

#[cfg(test)]
mod tests;
