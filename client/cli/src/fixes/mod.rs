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
use echofix_core::drive::Drive;
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

/// Drives the log through a [`Vehicle`](echofix_client::vehicle::Vehicle) and asks as planned, each time from priors drawn around the
/// truth.
///
/// # Errors
/// When the truth is not known, the log does not fit together, or the service is out of reach.
pub async fn ask(
    drive: &Drive,
    localizer: &Localizer,
    plan: &Plan,
    bar: &ProgressBar,
) -> anyhow::Result<Replay> {
    let truth = if drive.truth.is_empty() { &drive.reference } else { &drive.truth };
    let Some(truth) = Truth::new(truth)? else {
        bail!("the drive of `{}` has neither truth nor reference poses to draw priors around", drive.vehicle);
    };
    let Questions { asked: questions, not_asked, left_out } = questions(drive, &truth, plan)?;
    if questions.is_empty() {
        bail!("the drive of `{}` holds no batch to ask with: {not_asked:?}", drive.vehicle);
    }
    bar.inc_length(questions.len() as u64);
    let places = Arc::new(Semaphore::new(plan.at_once));
    let mut asked = JoinSet::new();
    for (index, (question, true_pose)) in questions.into_iter().enumerate() {
        let (localizer, places) = (localizer.clone(), Arc::clone(&places));
        asked.spawn(async move {
            let _place = places.acquire_owned().await;
            let from = Instant::now();
            let answer = localizer.ask(&question).await;
            (index, question, true_pose, answer, from.elapsed().as_secs_f64() * 1e3)
        });
    }
    let mut fixes = BTreeMap::new();
    while let Some(done) = asked.join_next().await {
        let (index, question, true_pose, answer, round_trip_ms) = done.context("a question broke down")?;
        if let Err(CallError::Unavailable { .. }) = &answer {
            answer.context("the service is out of reach")?;
            continue;
        }
        fixes.insert(index, record::record(&question, &truth, &true_pose, answer, round_trip_ms));
        bar.inc(1);
    }
    Ok(Replay { fixes: fixes.into_values().collect(), not_asked, left_out })
}
