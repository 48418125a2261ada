//! Asking the service where the vehicle is.

use std::time::Duration;

use echofix_proto::v1;
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use tokio::time::Instant;
use tonic::Request;

use crate::backoff::{Backoff, BackoffPolicy};
use crate::refusal::CallError;
use crate::routing::{self, Asked, Router};
use crate::service::ServiceEndpoint;
use crate::vehicle::LocalizationQuestion;

/// How patiently the service is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LocalizerOptions {
    /// An answer is waited for this long, retries included; the service learns of it, and stops working
    /// on what nobody waits for.
    pub deadline: Duration,
    /// Waits between attempts.
    pub backoff: BackoffPolicy,
}

impl Default for LocalizerOptions {
    /// Two seconds, retrying after 50 ms at first.
    fn default() -> Self {
        let backoff = BackoffPolicy { initial: Duration::from_millis(50), max: Duration::from_millis(500) };
        Self { deadline: Duration::from_secs(2), backoff }
    }
}

/// A connection to the localization service; cheap to clone.
#[derive(Debug, Clone)]
pub struct Localizer {
    router: Router,
    options: LocalizerOptions,
}

impl Localizer {
    /// Prepares the connection, which is made with the first question and renewed when it breaks.
    ///
    /// Must be called within a tokio runtime.
    #[must_use]
    pub fn new(endpoint: impl Into<ServiceEndpoint>, options: LocalizerOptions) -> Self {
        Self { router: Router::new(endpoint.into().kept_alive()), options }
    }

    pub(crate) fn options(&self) -> LocalizerOptions {
        self.options
    }

    pub(crate) fn router(&self) -> &Router {
        &self.router
    }

    /// Sends a question; attempts that fail for the moment are repeated within the deadline.
    ///
    /// Dropping the future cancels the call. The answer still has to be judged:
    /// [`Vehicle::accept`](crate::vehicle::Vehicle::accept).
    ///
    /// # Errors
    /// The last attempt's failure, or the typed refusal.
    pub async fn ask(&self, question: &LocalizationQuestion) -> Result<v1::LocalizeResponse, CallError> {
        let until = Instant::now() + self.options.deadline;
        let mut backoff = Backoff::new(self.options.backoff);
        loop {
            let error = match self.ask_once(question, until).await {
                Ok(answer) => return Ok(answer),
                Err(error) => error,
            };
            let again = matches!(error, CallError::Unavailable { .. } | CallError::Overloaded { .. });
            let wait = backoff.next(error.retry_after());
            if !again || Instant::now() + wait >= until {
                return Err(error);
            }
            tokio::time::sleep(wait).await;
        }
    }

    async fn ask_once(
        &self,
        question: &LocalizationQuestion,
        until: Instant,
    ) -> Result<v1::LocalizeResponse, CallError> {
        let region = routing::region_of(&question.request);
        let Asked { channel, replica } = self.router.ask(region);
        // Where a replica that an answer named is silent, there is time left to ask at the configured address.
        let until = if replica.is_some() { halfway(until) } else { until };
        let mut request = Request::new(question.request.clone());
        routing::mark(&mut request, region);
        request.set_timeout(until.saturating_duration_since(Instant::now()));
        let mut client = LocalizationServiceClient::new(channel);
        let error = match tokio::time::timeout_at(until, client.localize(request)).await {
            Ok(Ok(answer)) => {
                self.router.heard(region, answer.metadata());
                return Ok(answer.into_inner());
            }
            Ok(Err(status)) => {
                self.router.heard(region, status.metadata());
                CallError::from(&status)
            }
            Err(_) => CallError::Deadline,
        };
        Err(self.router.left(replica.as_ref(), error))
    }
}

/// The middle of the time that is left.
pub(crate) fn halfway(until: Instant) -> Instant {
    let now = Instant::now();
    now + until.saturating_duration_since(now) / 2
}

#[cfg(test)]
mod tests;
