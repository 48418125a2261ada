//! Clients that send requests over real sockets, one after the other.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use echofix_client::refusal::CallError;
use echofix_proto::v1::LocalizeResponse;
use prost::Message;
use serde::Serialize;
use tokio::task::JoinSet;

use crate::machine::used_by;
use echofix_harness::percentiles::Percentiles;
use echofix_harness::process::ServiceProcess;
use echofix_harness::questions::DriveQuestions;
use echofix_harness::replay::patient_localizer;

/// Number of a request, its answer or refusal, and the milliseconds until it came.
pub(super) type Answered = (usize, Result<LocalizeResponse, CallError>, f64);

/// What a service achieved under load.
#[derive(Debug, Clone, Serialize)]
pub struct Load {
    /// Number of the service's compute threads.
    pub threads: usize,
    /// Number of clients. Each has one connection, and at most one request under way.
    pub clients: usize,
    /// Number of requests that were answered or refused.
    pub asked: usize,
    /// How long the clients sent requests, seconds.
    pub seconds: f64,
    /// Processor time of the service, seconds; absent where the system does not report it.
    pub service_cpu_s: Option<f64>,
    /// Processor time of the clients, seconds; absent where the system does not report it.
    pub clients_cpu_s: Option<f64>,
    /// Milliseconds from a request to its answer.
    pub latency_ms: Option<Percentiles>,
    /// Mean size of a request, kilobytes.
    pub request_kb: f64,
    /// Mean size of an answer, kilobytes; 0 when there is none.
    pub answer_kb: f64,
}

impl Load {
    /// Answers and refusals in a second.
    pub fn per_second(&self) -> f64 {
        self.asked as f64 / self.seconds
    }

    /// Milliseconds of the service's processor time for a request.
    pub fn service_ms(&self) -> Option<f64> {
        Some(self.service_cpu_s? * 1e3 / self.asked as f64)
    }

    /// Milliseconds of the clients' processor time for a request.
    pub fn clients_ms(&self) -> Option<f64> {
        Some(self.clients_cpu_s? * 1e3 / self.asked as f64)
    }

    /// Requests for each second of the service's processor time.
    pub fn per_core_second(&self) -> Option<f64> {
        Some(1e3 / self.service_ms()?)
    }
}

/// Sends every request once, one after the other.
///
/// # Errors
/// When the service cannot be reached.
pub(super) async fn once(
    service: &ServiceProcess,
    recording: &DriveQuestions,
) -> anyhow::Result<Vec<Answered>> {
    within(service, recording, 0..recording.count()).await
}

/// The same with a part of the requests.
///
/// # Errors
/// When the service cannot be reached.
pub(super) async fn within(
    service: &ServiceProcess,
    recording: &DriveQuestions,
    part: std::ops::Range<usize>,
) -> anyhow::Result<Vec<Answered>> {
    let localizer = patient_localizer(&service.grpc)?;
    let mut answers = Vec::with_capacity(part.len());
    for index in part {
        let from = Instant::now();
        let answer = reached(localizer.ask(recording.question(index)).await)?;
        answers.push((index, answer, milliseconds(from)));
    }
    Ok(answers)
}

/// Lets clients send requests for `span`. Each sends its next request as soon as the last one is answered.
///
/// # Errors
/// When the service cannot be reached.
pub(super) async fn closed_loop(
    service: &ServiceProcess,
    recording: &Arc<DriveQuestions>,
    clients: usize,
    threads: usize,
    span: Duration,
) -> anyhow::Result<(Load, Vec<Answered>)> {
    let used = || (used_by(service.pid()), used_by(std::process::id()));
    let next = Arc::new(AtomicUsize::new(0));
    let (before, began) = (used(), Instant::now());
    let mut asking = JoinSet::new();
    for _ in 0..clients {
        let (localizer, recording, next) =
            (patient_localizer(&service.grpc)?, Arc::clone(recording), Arc::clone(&next));
        asking.spawn(async move {
            let mut answers = Vec::new();
            while began.elapsed() < span {
                let index = next.fetch_add(1, Ordering::Relaxed) % recording.count();
                let from = Instant::now();
                let answer = reached(localizer.ask(recording.question(index)).await)?;
                answers.push((index, answer, milliseconds(from)));
            }
            anyhow::Ok(answers)
        });
    }
    let mut answers: Vec<Answered> = Vec::new();
    while let Some(asked) = asking.join_next().await {
        answers.extend(asked.context("a client broke down")??);
    }
    let (seconds, after) = (began.elapsed().as_secs_f64(), used());
    let between = |a: Option<Duration>, b: Option<Duration>| Some(b?.saturating_sub(a?).as_secs_f64());
    let load = Load {
        threads,
        clients,
        asked: answers.len(),
        seconds,
        service_cpu_s: between(before.0, after.0),
        clients_cpu_s: between(before.1, after.1),
        latency_ms: Percentiles::of(answers.iter().map(|(_, _, ms)| *ms)),
        request_kb: mean_kb(
            answers.iter().map(|(index, ..)| recording.question(*index).request.encoded_len()),
        ),
        answer_kb: mean_kb(
            answers.iter().filter_map(|(_, answer, _)| Some(answer.as_ref().ok()?.encoded_len())),
        ),
    };
    Ok((load, answers))
}

/// An answer or a refusal. All else is an error.
fn reached(
    answer: Result<LocalizeResponse, CallError>,
) -> anyhow::Result<Result<LocalizeResponse, CallError>> {
    match answer {
        Err(error) if !matches!(error, CallError::Refused { .. }) => Err(error).context("asking the service"),
        answer => Ok(answer),
    }
}

fn milliseconds(from: Instant) -> f64 {
    from.elapsed().as_secs_f64() * 1e3
}

fn mean_kb(bytes: impl Iterator<Item = usize>) -> f64 {
    let (count, sum) = bytes.fold((0_usize, 0), |(count, sum), bytes| (count + 1, sum + bytes));
    sum as f64 / 1e3 / count.max(1) as f64
}
