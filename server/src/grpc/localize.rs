//! `LocalizationService`: where am I?

mod encode;
mod kept;
#[cfg(test)]
mod tests;

use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use echofix_core::batch::Batch;
use echofix_core::calibration::Estimated;
use echofix_core::calibration::clock::clock_of_batch;
use echofix_core::own_error::{MountSigma, own_error};
use echofix_proto::v1::localization_service_server::LocalizationService;
use echofix_proto::v1::localize_stream_response::Outcome as Streamed;
use echofix_proto::v1::{
    FixStatus, LocalizeRequest, LocalizeResponse, LocalizeStreamRequest, LocalizeStreamResponse,
};
use tokio::sync::Semaphore;
use tokio_stream::{Stream, StreamExt};
use tonic::metadata::MetadataMap;
use tonic::{Request, Response, Status, Streaming};
use tonic_types::pb;
use tracing::{Instrument, Span};

use super::access::Counted;
use super::invalid_field::{InvalidField, require, required};
use super::status;
use super::{attended, decode, faults, now_us};
use crate::feed::{Feed, FixEvent};
use crate::identity::Rated;
use crate::lanes::Lanes;
use crate::locating::{
    Admitted, Arriving, LocateAnswer, LocateRefusal, LocateRequest, Locator, verdict_word,
};
use crate::metrics::{Metrics, OutcomeLabel};
use crate::patience::Patience;
use crate::trace::in_current_span;
use encode::{BatchFacts, milliseconds, reason, refused, response};
use kept::{KeptBatches, StreamBatch};

/// Risks that protection levels can be given for. A level that may be exceeded half of the time bounds nothing.
pub const INTEGRITY_RISKS: std::ops::RangeInclusive<f64> = 1e-9..=0.1;
/// No vehicle can use an answer that is off by more.
const MAX_ALERT_LIMIT_M: f64 = 1_000.0;
/// Answers that wait to be checked, at most.
const CHECKS_WAITING: usize = 64;
/// Bytes of batches that are kept for streams, where nothing else is set.
const KEPT_BYTES: usize = 64 << 20;

/// Answers localization requests.
pub struct LocalizationApi {
    inner: Arc<Localization>,
    /// Without lanes of its own it computes on the runtime of its caller.
    lanes: Option<Lanes>,
    kept: Arc<KeptBatches>,
}

struct Localization {
    answered: AtomicU64,
    /// Checks that wait for their turn may be so many.
    checks_waiting: Semaphore,
    check_turn: tokio::sync::Mutex<()>,
    locator: Arc<Locator>,
    feed: Arc<Feed>,
    metrics: Arc<Metrics>,
}

impl LocalizationApi {
    /// Answers from a locator; feeds and metrics record every outcome.
    #[must_use]
    pub fn new(locator: Arc<Locator>, feed: Arc<Feed>, metrics: Arc<Metrics>) -> Self {
        let inner = Arc::new(Localization::new(locator, feed, metrics));
        Self { inner, lanes: None, kept: KeptBatches::new(KEPT_BYTES, 1.0) }
    }

    /// Keeps batches for streams within so many bytes, of which one peer may have a share, 0 to 1.
    #[must_use]
    pub fn keeping(self, bytes: usize, share: f64) -> Self {
        Self { kept: KeptBatches::new(bytes, share), ..self }
    }

    /// Computes on these lanes.
    #[must_use]
    pub fn on(self, lanes: Lanes) -> Self {
        Self { lanes: Some(lanes), ..self }
    }

    fn lanes(&self) -> Lanes {
        self.lanes.clone().unwrap_or_else(Lanes::here)
    }

    /// Answers one request on this thread, from its columns to its answer.
    ///
    /// # Errors
    /// The refusal, as the call would return it.
    pub fn work(&self, request: LocalizeRequest, admitted: Admitted) -> Result<LocalizeResponse, Status> {
        self.inner.work(request, &Patience::default(), admitted).map(|(response, _)| response)
    }
}

#[tonic::async_trait]
impl LocalizationService for LocalizationApi {
    async fn localize(
        &self,
        request: Request<LocalizeRequest>,
    ) -> Result<Response<LocalizeResponse>, Status> {
        let (deadline, lanes) = (deadline(request.metadata()), self.lanes());
        let (_, mut extensions, request) = request.into_parts();
        // Its place among those that arrive is kept until it asks for a slot.
        drop(extensions.remove::<Arc<Arriving>>());
        self.inner.answer(request, deadline, &lanes).await.map(Response::new)
    }

    type LocalizeStreamStream = Pin<Box<dyn Stream<Item = Result<LocalizeStreamResponse, Status>> + Send>>;

    async fn localize_stream(
        &self,
        request: Request<Streaming<LocalizeStreamRequest>>,
    ) -> Result<Response<Self::LocalizeStreamStream>, Status> {
        let peer = super::peer(request.extensions());
        let stream = Arc::new(StreamCall {
            inner: Arc::clone(&self.inner),
            deadline: deadline(request.metadata()),
            lanes: self.lanes(),
            caller: super::access::caller(request.extensions())?,
            // The answers are made after this call has returned, and belong to its span still.
            call: Span::current(),
            batch: Mutex::new(StreamBatch::new(Arc::clone(&self.kept), peer)),
        });
        let answers = request.into_inner().then(move |asked| {
            let stream = Arc::clone(&stream);
            async move { stream.answer(asked.map_err(faults::told)?).await }
        });
        Ok(Response::new(Box::pin(answers)))
    }
}

/// One vehicle's stream; its questions come one after the other.
struct StreamCall {
    inner: Arc<Localization>,
    deadline: Option<Instant>,
    lanes: Lanes,
    caller: Counted,
    call: Span,
    batch: Mutex<StreamBatch>,
}

impl StreamCall {
    async fn answer(&self, asked: LocalizeStreamRequest) -> Result<LocalizeStreamResponse, Status> {
        if self.deadline.is_some_and(|at| at <= Instant::now()) {
            return Err(status::gone());
        }
        let sequence = asked.sequence;
        let span = tracing::info_span!(parent: &self.call, "message", sequence);
        let answer = match self.complete(asked) {
            Ok(request) => self.inner.answer(request, self.deadline, &self.lanes).instrument(span).await,
            Err(status) => Err(status),
        };
        let outcome = match answer {
            Ok(response) => Streamed::Response(response),
            Err(status) => Streamed::Error(as_message(&status)),
        };
        let kept_batch = self.batch().number();
        Ok(LocalizeStreamResponse { sequence, outcome: Some(outcome), kept_batch })
    }

    /// The whole question.
    fn complete(&self, asked: LocalizeStreamRequest) -> Result<LocalizeRequest, Status> {
        self.caller.count(Rated::Localize)?;
        let LocalizeStreamRequest { sequence, request, delta, keep_batch } = asked;
        self.batch().complete(sequence, request.unwrap_or_default(), delta, keep_batch)
    }

    fn batch(&self) -> std::sync::MutexGuard<'_, StreamBatch> {
        // A batch that is kept or not is sound either way.
        self.batch.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a request is told that is not even received, and counted as.
pub(super) fn turned_away(metrics: &Metrics, refusal: &LocateRefusal) -> Status {
    metrics.fixes.get_or_create(&OutcomeLabel { outcome: reason(refusal) }).inc();
    refused(refusal)
}

/// A status as a message: its details already are an encoded `google.rpc.Status`.
fn as_message(status: &Status) -> pb::Status {
    let plain = || pb::Status {
        code: status.code().into(),
        message: status.message().to_owned(),
        details: Vec::new(),
    };
    prost::Message::decode(status.details()).ok().filter(|s: &pb::Status| s.code != 0).unwrap_or_else(plain)
}

impl Localization {
    fn new(locator: Arc<Locator>, feed: Arc<Feed>, metrics: Arc<Metrics>) -> Self {
        let (checks_waiting, check_turn) = (Semaphore::new(CHECKS_WAITING), tokio::sync::Mutex::default());
        Self { answered: AtomicU64::new(0), checks_waiting, check_turn, locator, feed, metrics }
    }

    async fn answer(
        self: &Arc<Self>,
        request: LocalizeRequest,
        deadline: Option<Instant>,
        lanes: &Lanes,
    ) -> Result<LocalizeResponse, Status> {
        let admitted = self.locator.admit().await.map_err(|refusal| self.refuse(&refusal))?;
        let inner = Arc::clone(self);
        let (response, check) =
            attended(&lanes.localizing, deadline, move |patience| inner.work(request, patience, admitted))
                .await?;
        if let Some(check) = check {
            lanes.background.spawn(Arc::clone(self).check_later(check).in_current_span());
        }
        Ok(response)
    }

    /// Decodes, answers, encodes and records; computes for a while. A sampled answer is to be checked afterwards.
    fn work(
        &self,
        request: LocalizeRequest,
        patience: &Patience,
        mut admitted: Admitted,
    ) -> Result<(LocalizeResponse, Option<SampledCheck>), Status> {
        if patience.is_over() {
            return Err(self.refuse(&LocateRefusal::Gone));
        }
        let asked = self.decoded(request, patience.clone()).map_err(|violation| {
            tracing::debug!(field = violation.field, "request not valid");
            self.count("INVALID_ARGUMENT");
            status::invalid(&violation)
        })?;
        let (at, reference_time_us) = (asked.request.at, asked.reference_time_us);
        let batch = BatchFacts::of(&asked.request.batch);
        let answer = self.locator.locate(&asked.request, &mut admitted).map_err(|r| self.refuse(&r))?;
        let mut response = response(&answer, reference_time_us, asked.alert_limit_m, &batch);
        if let Some(clock) = &asked.clock {
            response.status_reason.push_str(&clock_in_words(clock));
        }
        self.record(&answer, &response, at.lat_deg, at.lon_deg);
        let check = self.is_sampled().then_some(SampledCheck { request: asked.request, answer });
        Ok((response, check))
    }

    /// Is this answer one of the fraction to be checked? They are evenly spread.
    fn is_sampled(&self) -> bool {
        let fraction = self.locator.config().confirm_share;
        let count = self.answered.fetch_add(1, Ordering::Relaxed) as f64;
        ((count + 1.0) * fraction).floor() > (count * fraction).floor()
    }

    /// Checks an answer when it is its turn; when too many wait, it is left unchecked.
    async fn check_later(self: Arc<Self>, check: SampledCheck) {
        let outcome = OutcomeLabel { outcome: "skipped" };
        let Ok(_waiting) = self.checks_waiting.try_acquire() else {
            self.metrics.confirmations.get_or_create(&outcome).inc();
            return;
        };
        let _turn = self.check_turn.lock().await;
        let inner = Arc::clone(&self);
        let checked = tokio::task::spawn_blocking(in_current_span(move || inner.run_check(&check))).await;
        if let Err(error) = checked {
            tracing::error!(%error, "a check did not end as it should");
        }
    }

    /// Repeats an answer with an exact engine; computes for long.
    fn run_check(&self, SampledCheck { request, answer }: &SampledCheck) {
        let outcome = match self.locator.check_sample(request, answer) {
            Ok(true) => "agree",
            Ok(false) => {
                tracing::warn!("the exact engine found another pose than the answer");
                "differ"
            }
            Err(error) => {
                tracing::debug!(%error, "an answer could not be checked");
                return;
            }
        };
        self.metrics.confirmations.get_or_create(&OutcomeLabel { outcome }).inc();
    }

    fn refuse(&self, refusal: &LocateRefusal) -> Status {
        // Without its message, which holds a position.
        tracing::debug!(reason = reason(refusal), "not located");
        turned_away(&self.metrics, refusal)
    }

    fn decoded(&self, request: LocalizeRequest, patience: Patience) -> Result<DecodedRequest, InvalidField> {
        let batch = decode::batch(request.batch, "batch")?;
        let prior = required(request.prior, "prior")?;
        let (at, yaw_rad) = decode::geodetic_pose(prior.pose, "prior.pose")?;
        let combine = prior.combine;
        let believed = decode::uncertainty(&prior)?;
        let requirement = request.requirement.unwrap_or_default();
        let (risk, limit) = (requirement.integrity_risk, requirement.alert_limit_m);
        let rule = "must lie within 1e-9 and 0.1; 0 or nothing takes the service's default";
        require(risk.abs() <= 0.0 || INTEGRITY_RISKS.contains(&risk), "requirement.integrity_risk", rule)?;
        let rule = "must lie within 0 and 1000; 0 or nothing sets none";
        require((0.0..=MAX_ALERT_LIMIT_M).contains(&limit), "requirement.alert_limit_m", rule)?;
        let gate = self.locator.config().gate();
        let reference_time_us = batch.reference_time_us;
        let mut organised =
            Batch::organise(batch.scans.iter(), &batch.mounts, &batch.odometry, reference_time_us, &gate)
                .map_err(|e| InvalidField::new("batch.odometry", e))?;
        organised.quality = batch.quality;
        let standing = organised.points.len() as u64;
        let told = batch.told.mostly_moving(standing).or_else(|| batch.told.suspicion(standing));
        organised.findings.extend(told);
        let decode::DecodedBatch { mounts, mount_sigmas, odometry, .. } = &batch;
        // A clock that is off as the batch itself shows is no better known than by how much it is off.
        let clock = clock_of_batch(batch.scans.iter(), mounts, odometry);
        let known =
            |m: &MountSigma| MountSigma { time_s: clock.map_or(0.0, |c| c.value).hypot(m.time_s), ..*m };
        let sigmas: Vec<_> = mount_sigmas.iter().map(known).collect();
        organised.own_error = own_error(&organised, odometry, reference_time_us, mounts, &sigmas);
        let request = LocateRequest {
            batch: organised,
            at,
            yaw_rad,
            covariance: believed.covariance,
            sigma_position_m: believed.sigma_position_m,
            sigma_yaw_rad: believed.sigma_yaw_rad,
            combine,
            patience,
            integrity_risk: (risk > 0.0).then_some(risk),
        };
        Ok(DecodedRequest { request, reference_time_us, alert_limit_m: limit, clock })
    }

    fn count(&self, outcome: &'static str) {
        self.metrics.fixes.get_or_create(&OutcomeLabel { outcome }).inc();
    }

    /// Metrics and the operators' feed.
    fn record(
        &self,
        answer: &LocateAnswer,
        response: &LocalizeResponse,
        prior_lat_deg: f64,
        prior_lon_deg: f64,
    ) {
        let word = match response.status() {
            FixStatus::AboveAlertLimit => "ABOVE_ALERT_LIMIT",
            _ => verdict_word(&answer.alignment.verdict),
        };
        tracing::debug!(status = word, align_ms = milliseconds(answer.timing.align), "located");
        self.count(word);
        self.metrics.align_seconds.observe(answer.timing.align.as_secs_f64());
        self.metrics.queue_seconds.observe(answer.timing.queued.as_secs_f64());
        let outcome = if answer.timing.window_cached { "hit" } else { "miss" };
        self.metrics.windows.get_or_create(&OutcomeLabel { outcome }).inc();
        let correction = answer.alignment.correction;
        let valid = response.protection.as_ref().is_some_and(|p| p.valid);
        self.feed.fixes.publish(FixEvent {
            answered_us: now_us(),
            status: word,
            reason: response.status_reason.clone(),
            latitude_deg: answer.at.lat_deg,
            longitude_deg: answer.at.lon_deg,
            yaw_rad: answer.yaw_rad,
            prior_latitude_deg: prior_lat_deg,
            prior_longitude_deg: prior_lon_deg,
            correction_m: correction.x_m.hypot(correction.y_m),
            matched_fraction: answer.alignment.matched_fraction,
            protection_m: valid.then(|| answer.protection.horizontal_m()),
            align_ms: milliseconds(answer.timing.align),
        });
    }
}

/// What the batch says of its clock, to follow the reason of the status.
fn clock_in_words(clock: &Estimated) -> String {
    let word = if clock.value > 0.0 { "late" } else { "early" };
    format!(
        "; the radars' clock is {word} by {:.0} +- {:.0} ms against odometry, which the levels take in",
        1e3 * clock.value.abs(),
        1e3 * clock.sigma
    )
}

/// An answer that is to be repeated with an exact engine.
struct SampledCheck {
    request: LocateRequest,
    answer: LocateAnswer,
}

/// When the caller no longer waits, as its `grpc-timeout` says.
fn deadline(metadata: &MetadataMap) -> Option<Instant> {
    let timeout = metadata.get("grpc-timeout")?.to_str().ok()?;
    let (digits, unit) = timeout.split_at_checked(timeout.len().checked_sub(1)?)?;
    let count: u64 = digits.parse().ok()?;
    let wait = match unit {
        "H" => Duration::from_secs(count.checked_mul(3600)?),
        "M" => Duration::from_secs(count.checked_mul(60)?),
        "S" => Duration::from_secs(count),
        "m" => Duration::from_millis(count),
        "u" => Duration::from_micros(count),
        "n" => Duration::from_nanos(count),
        _ => return None,
    };
    Instant::now().checked_add(wait)
}

struct DecodedRequest {
    request: LocateRequest,
    reference_time_us: i64,
    alert_limit_m: f64,
    /// By how much the radars' clock is off, where the batch shows it.
    clock: Option<Estimated>,
}
