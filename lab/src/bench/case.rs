//! One alignment: a batch, the map around its prior, and the settings of the search.

use std::sync::Arc;

use echofix_core::align::verdict::Integrity;
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Prior, Search};
use echofix_core::batch::Batch;
use echofix_core::window::MapSquare;

/// One alignment, with all that an engine needs for it.
pub(super) struct Case {
    pub(super) square: MapSquare,
    pub(super) tiles: Vec<Arc<TileWeights>>,
    pub(super) batch: Batch,
    pub(super) prior: Prior,
    pub(super) search: Search,
    pub(super) integrity: Integrity,
}
