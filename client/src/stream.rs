//! Asking again and again over one stream, which carries only what is new.

use std::sync::Arc;

use echofix_core::geo::RoutingRegion;
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use echofix_proto::v1::localize_stream_response::Outcome;
use echofix_proto::{delta, v1};
use prost::Message;
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout_at};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Status, Streaming};

use crate::backoff::Backoff;
use crate::localizer::{Localizer, halfway};
use crate::refusal::{CallError, RefusalReason};
use crate::routing::{self, Asked};
use crate::vehicle::LocalizationQuestion;

/// Bytes that gRPC puts before each message.
const FRAME_BYTES: u64 = 5;

/// What a stream has sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StreamTraffic {
    /// Questions with a whole batch.
    pub whole: u64,
    /// Questions with what was new of it.
    pub deltas: u64,
    /// Bytes of both.
    pub bytes: u64,
}

/// One vehicle's questions to the service, one after the other. Each gets the answer that [`Localizer::ask`] gets, for a
/// fraction of the bytes: while the service keeps the last batch, only what is new of the next one is sent.
///
/// A stream that breaks is made anew, and so is one whose vehicle has come into another [`RoutingRegion`], or whose region another
/// replica keeps warm, as an answer said. A service
/// that keeps no batches is asked with whole ones.
#[derive(Debug)]
pub struct LocalizationStream {
    localizer: Localizer,
    open: Option<OpenStream>,
    sequence: u64,
    traffic: StreamTraffic,
}

#[derive(Debug)]
struct OpenStream {
    questions: mpsc::Sender<v1::LocalizeStreamRequest>,
    answers: Streaming<v1::LocalizeStreamResponse>,
    region: Option<RoutingRegion>,
    /// The replica that it goes to, where it is not the configured address.
    replica: Option<Arc<str>>,
    /// The batch that the service keeps, and its question's number.
    kept: Option<(u64, v1::Batch)>,
}

/// What came of one attempt.
enum Attempt {
    Done(Box<v1::LocalizeResponse>),
    /// The service does not have the base any more.
    Whole,
    /// A stream from an earlier question turned out to be broken.
    Anew,
    Failed(CallError),
}

impl LocalizationStream {
    pub(crate) fn new(localizer: Localizer) -> Self {
        Self { localizer, open: None, sequence: 0, traffic: StreamTraffic::default() }
    }

    /// What was sent so far.
    #[must_use]
    pub fn traffic(&self) -> StreamTraffic {
        self.traffic
    }

    /// Sends a question, and waits for its answer as [`Localizer::ask`] does. After the future was dropped the stream goes on
    /// with the next question.
    ///
    /// # Errors
    /// The last attempt's failure, or the typed refusal.
    pub async fn ask(&mut self, question: &LocalizationQuestion) -> Result<v1::LocalizeResponse, CallError> {
        let options = self.localizer.options();
        let until = Instant::now() + options.deadline;
        let mut backoff = Backoff::new(options.backoff);
        loop {
            let error = match self.attempt(&question.request, until).await {
                Attempt::Done(answer) => return Ok(*answer),
                // Neither comes twice in a row: a whole question needs no base, and a new stream is not an old one.
                Attempt::Whole | Attempt::Anew => continue,
                Attempt::Failed(error) => error,
            };
            if matches!(&error, CallError::Failed { code: Code::Unimplemented, .. }) {
                return self.localizer.ask(question).await;
            }
            let again = matches!(error, CallError::Unavailable { .. } | CallError::Overloaded { .. });
            let wait = backoff.next(error.retry_after());
            if !again || Instant::now() + wait >= until {
                return Err(error);
            }
            tokio::time::sleep(wait).await;
        }
    }

    async fn attempt(&mut self, request: &v1::LocalizeRequest, until: Instant) -> Attempt {
        let region = routing::region_of(request);
        let asked_now = self.localizer.router().ask(region);
        let goes_on = |open: &OpenStream| open.region == region && open.replica == asked_now.replica;
        let mut open = match self.open.take().filter(goes_on) {
            Some(open) => open,
            None => match self.localizer.open_stream(region, asked_now, until).await {
                Ok(open) => open,
                Err(error) => return Attempt::Failed(error),
            },
        };
        let fresh = open.kept.is_none();
        self.sequence += 1;
        let (asked, was_delta) = asked(self.sequence, request, open.kept.as_ref());
        self.count(&asked, was_delta);
        if open.questions.send(asked).await.is_err() && !fresh {
            return Attempt::Anew;
        }
        // It is put back only when its answer came: what is dropped or times out leaves no stream that is a question behind.
        let until = if open.replica.is_some() { halfway(until) } else { until };
        let answer = match timeout_at(until, answer_to(&mut open.answers, self.sequence)).await {
            Ok(Ok(answer)) => answer,
            Ok(Err(_)) if !fresh => return Attempt::Anew,
            Ok(Err(status)) => return Attempt::Failed(self.left(&open, CallError::from(&status))),
            Err(_) => return Attempt::Failed(self.left(&open, CallError::Deadline)),
        };
        let kept = answer.kept_batch.filter(|number| *number == self.sequence);
        let batch = kept.zip(request.batch.clone());
        // Another one than this question's: the last base stays, where it is that.
        open.kept = batch.or(open.kept.take().filter(|(number, _)| answer.kept_batch == Some(*number)));
        let attempt = match answer.outcome {
            Some(Outcome::Response(answer)) => Attempt::Done(Box::new(answer)),
            Some(Outcome::Error(error)) => {
                match CallError::from(&Status::with_details(
                    Code::from(error.code),
                    error.message.clone(),
                    error.encode_to_vec().into(),
                )) {
                    CallError::Refused { reason: RefusalReason::NeedsWholeBatch, .. } if was_delta => {
                        open.kept = None;
                        Attempt::Whole
                    }
                    error => Attempt::Failed(error),
                }
            }
            None => Attempt::Failed(CallError::Failed {
                code: Code::Internal,
                message: "the answer is neither an answer nor a refusal".to_owned(),
            }),
        };
        self.open = Some(open);
        attempt
    }

    /// A stream that failed before its first answer, or was silent: its replica is not asked again, if it was not configured.
    fn left(&self, open: &OpenStream, error: CallError) -> CallError {
        self.localizer.router().left(open.replica.as_ref(), error)
    }

    fn count(&mut self, asked: &v1::LocalizeStreamRequest, was_delta: bool) {
        self.traffic.deltas += u64::from(was_delta);
        self.traffic.whole += u64::from(!was_delta);
        self.traffic.bytes += asked.encoded_len() as u64 + FRAME_BYTES;
    }
}

/// A question as it is sent, and whether it is a delta.
fn asked(
    sequence: u64,
    request: &v1::LocalizeRequest,
    kept: Option<&(u64, v1::Batch)>,
) -> (v1::LocalizeStreamRequest, bool) {
    let delta = kept
        .zip(request.batch.as_ref())
        .and_then(|((number, base), batch)| delta::between(*number, base, batch));
    let was_delta = delta.is_some();
    let request = if was_delta {
        v1::LocalizeRequest { batch: None, prior: request.prior.clone(), requirement: request.requirement }
    } else {
        request.clone()
    };
    (v1::LocalizeStreamRequest { sequence, request: Some(request), delta, keep_batch: true }, was_delta)
}

/// The answer to a question; those to earlier ones, which nobody waits for, are passed over.
async fn answer_to(
    answers: &mut Streaming<v1::LocalizeStreamResponse>,
    sequence: u64,
) -> Result<v1::LocalizeStreamResponse, Status> {
    loop {
        match answers.message().await? {
            Some(answer) if answer.sequence == sequence => return Ok(answer),
            Some(_) => {}
            None => return Err(Status::unavailable("the service ended the stream")),
        }
    }
}

impl Localizer {
    /// A stream of one vehicle's questions, which is opened with the first one.
    #[must_use]
    pub fn stream(&self) -> LocalizationStream {
        LocalizationStream::new(self.clone())
    }

    async fn open_stream(
        &self,
        region: Option<RoutingRegion>,
        Asked { channel, replica }: Asked,
        until: Instant,
    ) -> Result<OpenStream, CallError> {
        let (questions, asked) = mpsc::channel(1);
        let mut request = Request::new(ReceiverStream::new(asked));
        routing::mark(&mut request, region);
        let until = if replica.is_some() { halfway(until) } else { until };
        let mut client = LocalizationServiceClient::new(channel);
        let error = match timeout_at(until, client.localize_stream(request)).await {
            Ok(Ok(answers)) => {
                self.router().heard(region, answers.metadata());
                return Ok(OpenStream {
                    questions,
                    answers: answers.into_inner(),
                    region,
                    replica,
                    kept: None,
                });
            }
            Ok(Err(status)) => CallError::from(&status),
            Err(_) => CallError::Deadline,
        };
        Err(self.router().left(replica.as_ref(), error))
    }
}

#[cfg(test)]
mod tests;
