//! A drive asks where it is, and the answers are compared with the truth.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use echofix_client::refusal::CallError;
use echofix_client::service::{ServiceAddress, ServiceEndpoint};
use echofix_client::vehicle::LocalizationQuestion;
use echofix_client::{Localizer, LocalizerOptions};
use echofix_core::drive::Drive;
use echofix_proto::v1::LocalizeResponse;
use indicatif::ProgressBar;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::fix_record::FixRecord;
use crate::questions::{DriveQuestions, QuestionPlan};
use crate::recording::LeftOut;

/// Answers questions: a service, or this machine from tiles of its own.
pub trait Answering: Clone + Send + Sync + 'static {
    /// Answers one.
    fn answer(
        &self,
        question: &LocalizationQuestion,
    ) -> impl Future<Output = Result<LocalizeResponse, CallError>> + Send;
}

impl Answering for Localizer {
    async fn answer(&self, question: &LocalizationQuestion) -> Result<LocalizeResponse, CallError> {
        self.ask(question).await
    }
}

/// All fixes of a drive.
#[derive(Debug, Clone, Default)]
pub struct ReplayedDrive {
    /// In order of time.
    pub fixes: Vec<FixRecord>,
    /// Times at which the vehicle had nothing to ask with, by the reason.
    pub not_asked: BTreeMap<String, usize>,
    /// Detections that the vehicle's gates left out.
    pub left_out: LeftOut,
    /// What seems to be in another convention than the contract's, in words.
    pub findings: Vec<String>,
}

/// A localizer that waits patiently: a replay asks faster than any vehicle.
///
/// # Errors
/// When the address is not one.
pub fn patient_localizer(server: &str) -> anyhow::Result<Localizer> {
    Ok(patient_localizer_to(ServiceAddress::at(server).endpoint()?))
}

/// The same as somebody whom the service knows.
#[must_use]
pub fn patient_localizer_to(service: ServiceEndpoint) -> Localizer {
    let options = LocalizerOptions { deadline: Duration::from_mins(1), ..LocalizerOptions::default() };
    Localizer::new(service, options)
}

/// Asks all that a drive has to ask, so many questions at once.
///
/// # Errors
/// When there is nothing to ask, or the service is out of reach.
pub async fn ask(
    drive: &Drive,
    localizer: &impl Answering,
    plan: &QuestionPlan,
    at_once: usize,
    bar: &ProgressBar,
) -> anyhow::Result<ReplayedDrive> {
    let asked = Arc::new(DriveQuestions::of(drive, plan)?);
    bar.inc_length(asked.count() as u64);
    let permits = Arc::new(Semaphore::new(at_once));
    let mut calls = JoinSet::new();
    for index in 0..asked.count() {
        let (localizer, permits, asked) = (localizer.clone(), Arc::clone(&permits), Arc::clone(&asked));
        calls.spawn(async move {
            let _permit = permits.acquire_owned().await;
            let from = Instant::now();
            let answer = localizer.answer(asked.question(index)).await;
            (index, answer, from.elapsed().as_secs_f64() * 1e3)
        });
    }
    let mut fixes = BTreeMap::new();
    while let Some(done) = calls.join_next().await {
        let (index, answer, round_trip_ms) = done.context("a question broke down")?;
        if let Err(CallError::Unavailable { .. }) = &answer {
            answer.context("the service is out of reach")?;
            continue;
        }
        fixes.insert(index, FixRecord::of(&asked, index, answer, round_trip_ms));
        bar.inc(1);
    }
    let DriveQuestions { not_asked, left_out, findings, .. } = &*asked;
    Ok(ReplayedDrive {
        fixes: fixes.into_values().collect(),
        not_asked: not_asked.clone(),
        left_out: *left_out,
        findings: findings.iter().map(ToString::to_string).collect(),
    })
}
