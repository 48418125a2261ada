//! One thread's alignments: the engine, the climb, the verdict, and the buffers they reuse.

use std::sync::Arc;

use super::climb::{self, Flexible, Summit};
use super::correlation::Lattice;
use super::engine::{Bounded, Engine, Fast, Fft, Peak, Question};
use super::score::Field;
use super::thin::{BLOCK_M, Thinner};
use super::verdict::{Case, Integrity};
use super::view::MapView;
use super::weights::TileWeights;
use super::{Alignment, Prior, Search};
use crate::batch::Batch;
use crate::window::Frame;

/// Share of the highest hill's score below which a hill is not climbed: a climb adds some percent, and
/// rivals differ by less.
const RIVAL: f64 = 0.9;

/// Which engine searches.
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

/// What is aligned with what.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// The square of the map around the prior.
    pub frame: Frame,
    /// The tiles that exist in it.
    pub tiles: &'a [Arc<TileWeights>],
    /// The batch.
    pub batch: &'a Batch,
    /// Where it is believed to be.
    pub prior: &'a Prior,
}

/// One thread's engines and buffers.
#[derive(Default)]
pub struct Aligner {
    view: MapView,
    fast: Fast,
    bounded: Option<Box<Bounded>>,
    fft: Option<Box<Fft>>,
    thinner: Thinner,
    thinned: Vec<[f32; 3]>,
    peaks: Vec<Peak>,
    summits: Vec<Summit>,
    flexible: Flexible,
}

impl Aligner {
    /// Finds the pose of a batch on the map: search, climb, verdict.
    pub fn align(
        &mut self,
        task: &Task,
        kind: EngineKind,
        search: &Search,
        integrity: &Integrity,
    ) -> Alignment {
        let Task { batch, prior, .. } = *task;
        self.view.show(task.frame, task.tiles);
        self.thinner.thin(&batch.points, search.extent_m as f32, BLOCK_M, &mut self.thinned);
        let lattice = Lattice::of(prior, search);
        let question = Question { view: &self.view, batch, thinned: &self.thinned, prior, search, lattice };
        let engine: &mut dyn Engine = match kind {
            EngineKind::Fast => &mut self.fast,
            EngineKind::Bounded => &mut **self.bounded.get_or_insert_default(),
            EngineKind::Fft => &mut **self.fft.get_or_insert_default(),
        };
        engine.search(&question, &mut self.peaks);
        let field = Field::of(&self.view);
        climbed(&field, &self.thinned, prior, &self.peaks, &mut self.summits);
        let rigid = self.summits.first().copied();
        self.flexible.take(batch, search, BLOCK_M);
        let answer =
            rigid.map(|summit| self.flexible.climb(&field.sharpened(), prior, &summit, &search.drift));
        let case = Case { question: &question, field: &field, answer, summits: &self.summits };
        case.judge(integrity)
    }
}

/// The summits, best first. Hills that cannot be rivals any more keep the score of their foot.
pub(super) fn climbed(
    field: &Field,
    points: &[[f32; 3]],
    prior: &Prior,
    peaks: &[Peak],
    summits: &mut Vec<Summit>,
) {
    summits.clear();
    summits.extend(peaks.iter().map(|peak| Summit::foot(field, points, prior, peak)));
    let highest = summits.iter().map(|foot| foot.score).fold(0.0, f64::max);
    for (summit, peak) in summits.iter_mut().zip(peaks) {
        if summit.score > RIVAL * highest {
            *summit = climb::climb(field, points, prior, peak);
        }
    }
    summits.sort_by(|a, b| b.score.total_cmp(&a.score));
}
