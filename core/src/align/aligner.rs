//! One thread's alignments: the pipeline, the drift, the verdict.

use std::sync::Arc;

use super::answer::{Alignment, Findings};
use super::drift::{DriftPrior, DriftRefiner};
use super::engine::Engine;
use super::pipeline::Pipeline;
use super::rivals::RivalFinder;
use super::thin::BLOCK_M;
use super::verdict::Integrity;
use super::weights::TileWeights;
use super::{Prior, Search};
use crate::batch::Batch;
use crate::window::MapSquare;

/// What is aligned with what.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// The square of the map around the prior.
    pub square: MapSquare,
    /// The tiles that exist in it.
    pub tiles: &'a [Arc<TileWeights>],
    /// The batch.
    pub batch: &'a Batch,
    /// The rough pose.
    pub prior: &'a Prior,
}

/// One thread's buffers.
#[derive(Default)]
pub struct Aligner {
    pipeline: Pipeline,
    drift: DriftRefiner,
    rivals: RivalFinder,
}

impl Aligner {
    /// Finds the pose of a batch on the map, by an engine ([`super::EngineKind::engine`], or the caller's own).
    pub fn align(
        &mut self,
        task: &Task,
        engine: &dyn Engine,
        search: &Search,
        integrity: &Integrity,
    ) -> Alignment {
        let Task { batch, prior, .. } = *task;
        self.pipeline.assemble(task.square, task.tiles);
        self.pipeline.thin(&batch.points, search.extent_m);
        let ranking = self.pipeline.rank(engine, batch, prior, search, None);
        self.drift.load(batch, search, BLOCK_M);
        let sharp = ranking.field.sharpened();
        let best = ranking.refined.first();
        let drift = search.drift.unwrap_or_else(|| DriftPrior::of(batch));
        let answer = best.map(|rigid| self.drift.refine(&sharp, prior, rigid, &drift, integrity.temperature));
        let challenge = self.rivals.challenge(&ranking);
        Findings { ranking: &ranking, answer, challenge }.judge(integrity)
    }
}
