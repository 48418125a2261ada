//! Asking the service where the vehicle is.

use std::time::Duration;

use echofix_proto::v1;
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use tokio::time::Instant;
use tonic::Request;

use crate::backoff::{Backoff, BackoffPolicy};
use crate::refusal::CallError;
use crate::routing;
use crate::service::{CallerChannel, ServiceEndpoint};
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
    client: LocalizationServiceClient<CallerChannel>,
    options: LocalizerOptions,
}

impl Localizer {
    /// Prepares the connection, which is made with the first question and renewed when it breaks.
    ///
    /// Must be called within a tokio runtime.
    #[must_use]
    pub fn new(endpoint: impl Into<ServiceEndpoint>, options: LocalizerOptions) -> Self {
        // A connection that died without a word is noticed between questions.
        let mut endpoint = endpoint.into();
        endpoint.transport = endpoint
            .transport
            .http2_keep_alive_interval(Duration::from_secs(5))
            .keep_alive_timeout(Duration::from_secs(5))
            .keep_alive_while_idle(true);
        Self { client: LocalizationServiceClient::new(endpoint.connect_lazy()), options }
    }

    pub(crate) fn options(&self) -> LocalizerOptions {
        self.options
    }

    pub(crate) fn client(&self) -> LocalizationServiceClient<CallerChannel> {
        self.client.clone()
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
        let mut request = Request::new(question.request.clone());
        routing::mark(&mut request, routing::region_of(&question.request));
        request.set_timeout(until.saturating_duration_since(Instant::now()));
        let mut client = self.client.clone();
        match tokio::time::timeout_at(until, client.localize(request)).await {
            Ok(Ok(answer)) => Ok(answer.into_inner()),
            Ok(Err(status)) => Err(CallError::from(&status)),
            Err(_) => Err(CallError::Deadline),
        }
    }
}

#[cfg(test)]
mod tests;
