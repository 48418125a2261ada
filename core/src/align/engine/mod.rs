//! Engines: ways to find the maximum of the correlation.
//!
//! An [`Engine`] is a value without state. It answers many [`SearchQuestion`]s at once, so that one that
//! works in batches can be handed in like those below; its buffers live in an [`EngineWorkspace`].
//!
//! The exact ones maximise the same discretised correlation, the sum of the map's weights below the
//! batch's occupied cells, and so find the same maximum; of equal sums the first in the lattice's order.
//!
//! - [`Fast`]: coarse to fine, what the service asks; not exact, see its measured miss rate.
//! - [`Bounded`]: exact, by bounds that rule out all but a few shifts.
//! - [`Fft`]: exact, every hypothesis, at a cost that does not grow with the batch.
//! - [`Reference`]: exact, double precision, no shortcut: what the others are measured by.

mod bounded;
mod fast;
mod fft;
mod question;
mod reference;
mod scan;
mod stepped;
mod workspace;

pub use bounded::Bounded;
pub use fast::Fast;
pub use fft::Fft;
pub use question::SearchQuestion;
pub use reference::Reference;
pub use stepped::Stepped;
pub use workspace::EngineWorkspace;

use crate::pose::Pose2;

/// A local maximum of the correlation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// The hypothesis: metres east and north of the prior, radians.
    pub correction: Pose2,
    /// Mean weight of the points that the engine counted, in units of the logarithm: the batch's occupied
    /// cells, or a part of its thinned points. The divisor is the same for every hypothesis, so that scores
    /// are in the order of the correlation.
    pub score: f64,
    /// True when it lies on the edge of the search.
    pub at_edge: bool,
}

/// A way to find the maximum of the correlation.
pub trait Engine: Send + Sync {
    /// Its name in tables and configuration.
    fn name(&self) -> &'static str;

    /// Writes the highest candidates of each question, best first: at most the search's number of them.
    /// There are as many lists as questions; what they held is overwritten.
    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    );

    /// The same for one question.
    fn search(
        &self,
        question: &SearchQuestion<'_>,
        workspace: &mut EngineWorkspace,
        candidates: &mut Vec<Candidate>,
    ) {
        self.search_all(std::slice::from_ref(question), workspace, std::slice::from_mut(candidates));
    }
}

/// The engines that configuration can name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EngineKind {
    /// Coarse to fine.
    #[default]
    Fast,
    /// Exact, by bounds.
    Bounded,
    /// Exact, every hypothesis.
    Fft,
}

impl EngineKind {
    /// The engine, on the fastest instruction set of this processor.
    #[must_use]
    pub fn engine(self) -> &'static dyn Engine {
        match self {
            Self::Fast => &Fast::BEST,
            Self::Bounded => &Bounded::BEST,
            Self::Fft => &Fft,
        }
    }
}

#[cfg(test)]
mod tests;
