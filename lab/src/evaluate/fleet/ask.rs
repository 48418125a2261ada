//! All questions of a drive.

use std::collections::BTreeMap;

use echofix_core::align::Search;
use echofix_core::drive::Drive;
use echofix_core::gate::Gate;
use echofix_core::geo::Grid;
use echofix_harness::questions::{DriveQuestions, TruthQuestion};
use indicatif::ProgressBar;
use rayon::prelude::*;

use super::FleetPlan;
use super::map::LogsMap;
use crate::evaluate::logged::LOG;
use crate::evaluate::method::Windows;
use crate::evaluate::trust::answer::Answerer;
use crate::evaluate::trust::batch::{BatchForm, Fault};
use crate::evaluate::trust::case::{Case, Place};
use crate::evaluate::trust::prior::PriorLie;
use crate::evaluate::trust::record::{Question, TrustRecord};
use crate::request;

/// A drive that was asked.
pub struct AskedDrive {
    /// Its name in tables.
    pub name: String,
    /// Every question with its answer, in order of time.
    pub rows: Vec<TrustRecord>,
    /// Uploads on its map, and uploads that vetting kept out of it.
    pub uploads: (usize, usize),
    /// Whether it was compared with a truth of its own, and not with its reference poses.
    pub has_truth: bool,
    /// Times at which the vehicle had nothing to ask with, by the reason.
    pub not_asked: BTreeMap<String, usize>,
    /// What seems to be in another convention than the contract's, in words.
    pub findings: Vec<String>,
}

/// What the questions of a drive are asked with.
pub struct DriveAsker<'a> {
    /// How to ask.
    pub plan: &'a FleetPlan,
    /// The grid of the map.
    pub grid: &'a Grid,
    /// The map.
    pub map: &'a LogsMap,
    /// Its prepared tiles.
    pub windows: &'a Windows,
    /// Counts batches.
    pub bar: &'a ProgressBar,
}

impl DriveAsker<'_> {
    /// Asks all that a drive has to ask. `number` is that of the drive.
    ///
    /// # Errors
    /// When there are no true poses or nothing to ask with.
    pub fn ask(&self, number: usize, name: String, drive: &Drive) -> anyhow::Result<AskedDrive> {
        let asked = DriveQuestions::of(drive, &self.plan.questions)?;
        let of_one_batch =
            |a: &TruthQuestion, b: &TruthQuestion| a.question.time_us() == b.question.time_us();
        let batches: Vec<_> = asked.questions.chunk_by(of_one_batch).collect();
        self.bar.inc_length(batches.len() as u64);
        let (case, search) = (self.case(name.clone()), self.search());
        let rows = batches.par_iter().enumerate().map_init(
            || Answerer::new(search, self.plan.risk),
            |answerer, (batch, questions)| {
                self.bar.inc(1);
                self.ask_batch(answerer, (number, batch), &case, questions)
            },
        );
        Ok(AskedDrive {
            name,
            rows: rows.collect::<anyhow::Result<Vec<_>>>()?.into_iter().flatten().collect(),
            uploads: (self.map.folded, self.map.quarantined),
            has_truth: !drive.truth.is_empty(),
            not_asked: asked.not_asked,
            findings: asked.findings.iter().map(ToString::to_string).collect(),
        })
    }

    /// Asks the questions of one batch.
    fn ask_batch(
        &self,
        answerer: &mut Answerer,
        (drive, number): (usize, usize),
        case: &Case,
        questions: &[TruthQuestion],
    ) -> anyhow::Result<Vec<TrustRecord>> {
        let gate = Gate { max_range_m: self.plan.questions.max_range_m, ..Gate::default() };
        let mut batch = None;
        let mut rows = Vec::new();
        for (prior_number, TruthQuestion { question: asked, truth }) in questions.iter().enumerate() {
            let batch = match &batch {
                Some(batch) => batch,
                None => batch.insert(request::batch(&asked.request, &gate)?),
            };
            let question = Question {
                family: LOG,
                seed: drive as u64,
                case,
                batch: number,
                time_us: asked.time_us(),
                prior_number,
                points: batch.points.len(),
                speed_mps: batch.speed_mps,
                prior: request::prior_on(self.grid, &request::believed(&asked.request))?,
                truth: Some(self.grid.pose_from_geodetic(truth.at, truth.yaw_rad)?),
            };
            rows.push(if batch.findings.iter().any(|finding| !finding.suspects().is_empty()) {
                TrustRecord::refused(&question, "WRONG_CONVENTION")
            } else {
                let tiles = |square| self.windows.weights(&self.map.map, square);
                answerer.answer(&question, batch, self.grid, tiles)
            });
        }
        Ok(rows)
    }

    fn search(&self) -> Search {
        Search { extent_m: self.plan.questions.max_range_m, ..Search::default() }
    }

    fn case(&self, name: String) -> Case {
        let form = BatchForm { length_s: self.plan.questions.batch_s, fault: Fault::None, declared: false };
        let priors = self.plan.questions.priors;
        Case { name, k: 0.0, place: Place::Mapped, form, lie: PriorLie::Honest, priors }
    }
}
