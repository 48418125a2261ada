//! Answers questions on a map as the service does.

use std::sync::Arc;

use echofix_core::align::verdict::Integrity;
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Aligner, EngineKind, Search, Task};
use echofix_core::batch::Batch;
use echofix_core::gate::Gate;
use echofix_core::geo::Grid;
use echofix_core::window::MapSquare;

use super::record::{Question, TrustRecord};
use super::world::square;

/// Batches with fewer points are refused by the service (`min_detections` of its configuration).
const MIN_POINTS: usize = 50;

/// One thread's aligner, with the settings of the service.
pub struct Answerer {
    aligner: Aligner,
    search: Search,
    integrity: Integrity,
    risk: f64,
}

impl Answerer {
    /// One that searches so, and whose levels are exceeded with this probability.
    pub fn new(search: Search, risk: f64) -> Self {
        Self { aligner: Aligner::default(), search, integrity: Integrity::default(), risk }
    }

    /// The answer to a question, or the refusal. `tiles` are the prepared tiles of a square of the map.
    pub fn answer(
        &mut self,
        question: &Question,
        batch: &Batch,
        grid: &Grid,
        tiles: impl FnOnce(MapSquare) -> Vec<Arc<TileWeights>>,
    ) -> TrustRecord {
        if batch.points.len() < MIN_POINTS || batch.speed_mps < Gate::default().min_speed_mps {
            return TrustRecord::refused(question, "TOO_FEW_DETECTIONS");
        }
        let (prior, search) = (&question.prior, &self.search);
        let square = square(grid, &prior.pose, search.extent_m, search.sigmas * prior.sigma_position_m);
        let tiles = tiles(square);
        if tiles.is_empty() {
            return TrustRecord::refused(question, NO_MAP);
        }
        let task = Task { square, tiles: &tiles, batch, prior };
        let engine = EngineKind::default().engine();
        let answer = self.aligner.align(&task, engine, search, &self.integrity);
        TrustRecord::answered(question, &answer, &answer.protection(&self.integrity, self.risk))
    }
}

/// The refusal where the map holds nothing around the prior.
pub const NO_MAP: &str = "NO_MAP";
