//! A drive asks where it is, and the answers are compared with the truth.

mod question;
mod record;
mod summary;
mod truth;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, bail};
use echofix_client::Localizer;
use echofix_client::refusal::CallError;
use echofix_client::vehicle::LocalizationQuestion;
use echofix_core::drive::{Drive, GeoPose};
use echofix_proto::v1::LocalizeResponse;
use indicatif::ProgressBar;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::contribute::LeftOut;
use question::{Questions, questions};
pub use record::Fix;
pub use summary::Summary;
use truth::Truth;

/// When to ask, and what to pretend to know.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Seconds between questions; 0 asks at every scan.
    pub every_s: f64,
    /// Seconds of scans a batch spans.
    pub batch_s: f64,
    /// Random priors a batch.
    pub priors: usize,
    /// One-sigma error of the priors' position along each axis, metres.
    pub sigma_position_m: f64,
    /// One-sigma error of the priors' heading, radians.
    pub sigma_yaw_rad: f64,
    /// Seed of the priors' errors.
    pub seed: u64,
    /// Seconds of scans that must have come before the first question.
    pub warm_up_s: f64,
    /// Questions under way at once.
    pub at_once: usize,
}

/// All fixes of a drive.
#[derive(Debug, Clone, Default)]
pub struct Replay {
    /// In order of time.
    pub fixes: Vec<Fix>,
    /// Times at which the vehicle had nothing to ask with, by the reason.
    pub not_asked: BTreeMap<String, usize>,
    /// Detections that the vehicle's gates left out.
    pub left_out: LeftOut,
}

/// The questions of a drive, and the truth to compare the answers with.
pub struct Recording {
    truth: Truth,
    questions: Questions,
}

impl Recording {
    /// Drives the log through a [`Vehicle`](echofix_client::vehicle::Vehicle) and notes what it would ask as planned, each
    /// time from priors drawn around the truth.
    ///
    /// # Errors
    /// When the truth is not known, the log does not fit together, or there is nothing to ask with.
    pub fn of(drive: &Drive, plan: &Plan) -> anyhow::Result<Self> {
        let truth = if drive.truth.is_empty() { &drive.reference } else { &drive.truth };
        let Some(truth) = Truth::new(truth)? else {
            bail!(
                "the drive of `{}` has neither truth nor reference poses to draw priors around",
                drive.vehicle
            );
        };
        let questions = questions(drive, &truth, plan)?;
        if questions.asked.is_empty() {
            bail!("the drive of `{}` holds no batch to ask with: {:?}", drive.vehicle, questions.not_asked);
        }
        Ok(Self { truth, questions })
    }

    /// Number of questions, at least one.
    pub fn len(&self) -> usize {
        self.questions.asked.len()
    }

    /// A question, in order of time.
    pub fn question(&self, index: usize) -> &LocalizationQuestion {
        &self.questions.asked[index].0
    }

    /// Where the vehicle truly is at the time of a question.
    pub fn true_pose(&self, index: usize) -> &GeoPose {
        &self.questions.asked[index].1
    }

    /// What came of a question.
    pub fn fix(&self, index: usize, answer: Result<LocalizeResponse, CallError>, round_trip_ms: f64) -> Fix {
        let (question, true_pose) = &self.questions.asked[index];
        record::record(question, &self.truth, true_pose, answer, round_trip_ms)
    }
}

/// Asks all that a drive has to ask.
///
/// # Errors
/// When there is nothing to ask, or the service is out of reach.
pub async fn ask(
    drive: &Drive,
    localizer: &Localizer,
    plan: &Plan,
    bar: &ProgressBar,
) -> anyhow::Result<Replay> {
    let recording = Arc::new(Recording::of(drive, plan)?);
    bar.inc_length(recording.len() as u64);
    let places = Arc::new(Semaphore::new(plan.at_once));
    let mut asked = JoinSet::new();
    for index in 0..recording.len() {
        let (localizer, places, recording) = (localizer.clone(), Arc::clone(&places), Arc::clone(&recording));
        asked.spawn(async move {
            let _place = places.acquire_owned().await;
            let from = Instant::now();
            let answer = localizer.ask(recording.question(index)).await;
            (index, answer, from.elapsed().as_secs_f64() * 1e3)
        });
    }
    let mut fixes = BTreeMap::new();
    while let Some(done) = asked.join_next().await {
        let (index, answer, round_trip_ms) = done.context("a question broke down")?;
        if let Err(CallError::Unavailable { .. }) = &answer {
            answer.context("the service is out of reach")?;
            continue;
        }
        fixes.insert(index, recording.fix(index, answer, round_trip_ms));
        bar.inc(1);
    }
    let Questions { not_asked, left_out, .. } = &recording.questions;
    Ok(Replay { fixes: fixes.into_values().collect(), not_asked: not_asked.clone(), left_out: *left_out })
}
