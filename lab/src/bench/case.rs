//! A batch, the map around its prior, and how to search.

use std::sync::Arc;

use echofix_core::align::engine::Question;
use echofix_core::align::verdict::Integrity;
use echofix_core::align::view::MapView;
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Lattice, Prior, Search};
use echofix_core::batch::Batch;
use echofix_core::window::Frame;

/// A batch and the map around its prior.
pub(super) struct Case {
    pub(super) frame: Frame,
    pub(super) tiles: Vec<Arc<TileWeights>>,
    pub(super) batch: Batch,
    pub(super) prior: Prior,
    pub(super) search: Search,
    pub(super) integrity: Integrity,
}

impl Case {
    /// The question of a batch in the case's place, perhaps not its own.
    pub(super) fn question<'a>(
        &'a self,
        view: &'a MapView,
        batch: &'a Batch,
        thinned: &'a [[f32; 3]],
    ) -> Question<'a> {
        let Self { prior, search, .. } = self;
        Question { view, batch, thinned, prior, search, lattice: Lattice::of(prior, search) }
    }
}
