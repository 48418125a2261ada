//! From a map and points to ranked candidates: the steps that localizing, vetting and localizability share.
//!
//! 1. [`Pipeline::assemble`]: the map window around a prior becomes images of weights.
//! 2. [`Pipeline::thin`]: a batch becomes one point a block; or [`Pipeline::set_points`].
//! 3. [`Pipeline::search`]: an engine finds candidates.
//! 4. [`Pipeline::rank`]: the same, then those that can be the best are refined, and all are put in order.
//!
//! Who calls decides on the rest: whether the drift is estimated, which candidate is the answer, and what may
//! be done with it.

use std::sync::Arc;

use super::engine::{Candidate, Engine, EngineWorkspace, SearchQuestion};
use super::ranking::Ranking;
use super::refine::{RefinedCandidate, refine};
use super::score::ScoreField;
use super::thin::{BLOCK_M, Thinner};
use super::view::MapView;
use super::weights::TileWeights;
use super::{Prior, Search};
use crate::batch::Batch;
use crate::point::{BodyPoint, WeightedPoint};
use crate::window::MapSquare;

/// A candidate whose score is below this fraction of the highest one's is not refined: refining adds some
/// percent, and candidates that are confused with the best one differ by less.
const REFINED_ABOVE: f64 = 0.9;

/// One thread's steps, with the buffers that they reuse from request to request.
#[derive(Default)]
pub struct Pipeline {
    view: MapView,
    thinner: Thinner,
    points: Vec<WeightedPoint>,
    /// Detections of each point.
    counts: Vec<f32>,
    engine: EngineWorkspace,
    candidates: Vec<Candidate>,
    refined: Vec<RefinedCandidate>,
}

impl Pipeline {
    /// Shows the tiles of a square to the next steps.
    pub fn assemble(&mut self, square: MapSquare, tiles: &[Arc<TileWeights>]) {
        self.view.assemble(square, tiles);
    }

    /// Thins points to one a block, those within reach.
    pub fn thin(&mut self, points: &[BodyPoint], reach_m: f64) {
        self.thinner.thin(points, reach_m as f32, BLOCK_M, &mut self.points);
        self.counts.clear();
        self.counts.extend(self.thinner.counts());
    }

    /// Takes points that need no thinning.
    pub fn set_points(&mut self, points: impl IntoIterator<Item = WeightedPoint>) {
        self.points.clear();
        self.points.extend(points);
        self.counts.clear();
        self.counts.resize(self.points.len(), 1.0);
    }

    /// The thinned points.
    #[must_use]
    pub fn points(&self) -> &[WeightedPoint] {
        &self.points
    }

    /// What an engine finds around a prior, best first. An exact engine counts the cells of the batch, another
    /// one the thinned points.
    pub fn search(
        &mut self,
        engine: &dyn Engine,
        batch: &Batch,
        prior: &Prior,
        search: &Search,
    ) -> &[Candidate] {
        let question = SearchQuestion::new(&self.view, batch, &self.points, prior, search);
        engine.search(&question, &mut self.engine, &mut self.candidates);
        &self.candidates
    }

    /// What an engine finds around a prior, refined and ranked. The `expected` candidate is ranked with the
    /// engine's, and always refined: it need not be near a maximum.
    pub fn rank<'a>(
        &'a mut self,
        engine: &dyn Engine,
        batch: &'a Batch,
        prior: &'a Prior,
        search: &'a Search,
        expected: Option<Candidate>,
    ) -> Ranking<'a> {
        self.search(engine, batch, prior, search);
        let field = ScoreField::of(&self.view);
        let initial =
            |candidate: &Candidate| RefinedCandidate::unrefined(&field, &self.points, prior, candidate);
        let from_engine = self.candidates.len();
        self.candidates.extend(expected);
        self.refined.clear();
        self.refined.extend(self.candidates.iter().map(initial));
        let highest = self.refined.iter().map(|initial| initial.score).fold(0.0, f64::max);
        for (index, (refined, candidate)) in self.refined.iter_mut().zip(&self.candidates).enumerate() {
            if refined.score > REFINED_ABOVE * highest || index >= from_engine {
                *refined = refine(&field, &self.points, prior, candidate);
            }
        }
        self.refined.sort_by(|a, b| b.score.total_cmp(&a.score));
        let question = SearchQuestion::new(&self.view, batch, &self.points, prior, search);
        Ranking { question, counts: &self.counts, field, refined: &self.refined }
    }
}

#[cfg(test)]
mod tests;
