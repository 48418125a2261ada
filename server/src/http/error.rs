//! Why a request was not answered, and how that is said over HTTP.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::rejection::{JsonRejection, QueryRejection};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::answers::{ErrorAnswer, ErrorBody};
use crate::identity::{NotSignedIn, Refusal};
use crate::locating::NotAssessed;
use crate::pace::TooSlow;
use crate::sparse;
use crate::store;

/// Why a request was not answered.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A parameter is not what it should be.
    #[error("{0}")]
    BadRequest(String),
    /// There is nothing under this address.
    #[error("{0}")]
    NotFound(String),
    /// The route exists, the method does not.
    #[error("this method is not served here; see /openapi.json")]
    MethodNotAllowed,
    /// The request is for another name than the port's.
    #[error(
        "this port does not answer to the name in the request's Host; use its address or localhost, or add the name to \
         `http.hosts` of the configuration"
    )]
    WrongHost,
    /// Another page asks for it.
    #[error(
        "a page of another origin asks for this; list its origin in `http.cors_origins` of the configuration, or use the console \
         of this port or the command `echofix map`"
    )]
    WrongOrigin,
    /// A part of a file is asked for that the file does not have.
    #[error("the file has {size} bytes")]
    BehindTheEnd {
        /// Its size, bytes.
        size: u64,
    },
    /// Who asks is not known, or may not.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The issuer at which browsers sign in does not answer as issuers do.
    #[error("{0}")]
    Issuer(String),
    /// It is work, which no GET starts.
    #[error("{0} is work: ask for it with POST")]
    PostOnly(&'static str),
    /// The address is longer than any of ours.
    #[error("the address is longer than {limit} bytes")]
    AddressTooLong {
        /// Longest address that is served, bytes.
        limit: usize,
    },
    /// The caller, or its address, asks too often.
    #[error("{who} asks too often; try again in {} s", whole_seconds(*.wait))]
    TooOften {
        /// Who.
        who: &'static str,
        /// When to come again.
        wait: Duration,
    },
    /// All permits of this kind are taken.
    #[error("{0}; try again in a second")]
    Saturated(&'static str),
    /// The body of a request comes too slowly.
    #[error(transparent)]
    TooSlow(#[from] TooSlow),
    /// What is received cannot be kept.
    #[error("the file cannot be kept while it is received: {0}")]
    Spool(std::io::Error),
    /// No answer in time.
    #[error("no answer within {seconds} s")]
    TimedOut {
        /// How long an answer may take to begin, seconds.
        seconds: u64,
    },
    /// Nobody waits for the answer any more.
    #[error("the caller no longer waits")]
    Gone,
    /// The store refused.
    #[error("the map store: {0}")]
    Store(Arc<store::Error>),
    /// What several requests waited for failed.
    #[error(transparent)]
    Shared(Arc<Error>),
    /// Our own failure.
    #[error("{0}")]
    Internal(String),
}

impl Error {
    fn status(&self) -> StatusCode {
        match self {
            Self::BadRequest(_) => StatusCode::BAD_REQUEST,
            Self::NotFound(_) => StatusCode::NOT_FOUND,
            Self::MethodNotAllowed | Self::PostOnly(_) | Self::Refused(Refusal::NotServed) => {
                StatusCode::METHOD_NOT_ALLOWED
            }
            Self::BehindTheEnd { .. } => StatusCode::RANGE_NOT_SATISFIABLE,
            Self::WrongHost => StatusCode::MISDIRECTED_REQUEST,
            Self::Issuer(_) => StatusCode::BAD_GATEWAY,
            Self::WrongOrigin | Self::Refused(Refusal::Forbidden { .. } | Refusal::Forged) => {
                StatusCode::FORBIDDEN
            }
            Self::Refused(Refusal::Unauthenticated(_)) => StatusCode::UNAUTHORIZED,
            Self::AddressTooLong { .. } => StatusCode::URI_TOO_LONG,
            Self::TooOften { .. } => StatusCode::TOO_MANY_REQUESTS,
            Self::Saturated(_) | Self::Spool(_) => StatusCode::SERVICE_UNAVAILABLE,
            Self::TooSlow(_) => StatusCode::REQUEST_TIMEOUT,
            Self::TimedOut { .. } | Self::Gone => StatusCode::GATEWAY_TIMEOUT,
            Self::Store(error) => match **error {
                store::Error::Rebuilding { .. } => StatusCode::SERVICE_UNAVAILABLE,
                store::Error::Unusable(_) => StatusCode::BAD_REQUEST,
                store::Error::Unknown(_) => StatusCode::NOT_FOUND,
                _ => StatusCode::INTERNAL_SERVER_ERROR,
            },
            Self::Shared(error) => error.status(),
            Self::Internal(_) => StatusCode::INTERNAL_SERVER_ERROR,
        }
    }

    fn code(&self) -> &'static str {
        match self {
            Self::BadRequest(_) => "bad_request",
            Self::NotFound(_) => "not_found",
            Self::MethodNotAllowed | Self::PostOnly(_) | Self::Refused(Refusal::NotServed) => {
                "method_not_allowed"
            }
            Self::BehindTheEnd { .. } => "behind_the_end",
            Self::WrongHost => "wrong_host",
            Self::WrongOrigin => "wrong_origin",
            Self::Refused(Refusal::Unauthenticated(_)) => "unauthenticated",
            Self::Refused(Refusal::Forbidden { .. }) => "role_missing",
            Self::Refused(Refusal::Forged) => "csrf",
            Self::Issuer(_) => "issuer",
            Self::AddressTooLong { .. } => "address_too_long",
            Self::TooOften { .. } => "too_often",
            Self::Saturated(_) => "saturated",
            Self::TooSlow(_) => "too_slow",
            Self::Spool(_) => "no_room",
            Self::TimedOut { .. } | Self::Gone => "timed_out",
            Self::Store(error) => match **error {
                store::Error::Rebuilding { .. } => "rebuilding",
                store::Error::Unusable(_) => "bad_request",
                store::Error::Unknown(_) => "not_found",
                _ => "store",
            },
            Self::Shared(error) => error.code(),
            Self::Internal(_) => "internal",
        }
    }
}

/// As `Retry-After` takes them: not before the time has come.
fn whole_seconds(wait: Duration) -> u64 {
    wait.as_secs_f64().ceil().max(1.0) as u64
}

impl IntoResponse for Error {
    fn into_response(self) -> Response {
        let status = self.status();
        if status == StatusCode::INTERNAL_SERVER_ERROR
            && let Some(left_out) = sparse::line("request failed")
        {
            tracing::error!(error = %self, left_out, "request failed");
        }
        let wait = match &self {
            Self::TooOften { wait, .. } => Some(whole_seconds(*wait)),
            _ => (status == StatusCode::SERVICE_UNAVAILABLE).then_some(1),
        };
        let body = Json(ErrorAnswer { error: ErrorBody { code: self.code(), message: self.to_string() } });
        let mut response = (status, body).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if status == StatusCode::UNAUTHORIZED {
            let challenge = HeaderValue::from_static("Bearer realm=\"echofix\"");
            headers.insert(header::WWW_AUTHENTICATE, challenge);
        }
        if let Self::BehindTheEnd { size } = self
            && let Ok(whole) = HeaderValue::from_str(&format!("bytes */{size}"))
        {
            headers.insert(header::CONTENT_RANGE, whole);
        }
        // Which methods a route has, the router says itself.
        if let Some(wait) = wait {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(wait));
        }
        response
    }
}

impl From<store::Error> for Error {
    fn from(error: store::Error) -> Self {
        Self::Store(Arc::new(error))
    }
}

impl From<NotSignedIn> for Error {
    fn from(error: NotSignedIn) -> Self {
        let words = error.to_string();
        match error {
            NotSignedIn::NotConfigured => Self::NotFound(words),
            NotSignedIn::Issuer(_) => Self::Issuer(words),
            NotSignedIn::Refused(why) => Self::Refused(Refusal::Unauthenticated(why)),
        }
    }
}

impl From<Arc<store::Error>> for Error {
    fn from(error: Arc<store::Error>) -> Self {
        Self::Store(error)
    }
}

impl From<NotAssessed> for Error {
    fn from(error: NotAssessed) -> Self {
        match error {
            NotAssessed::Store(error) => Self::Store(error),
            NotAssessed::Gone => Self::Gone,
        }
    }
}

impl From<echofix_core::geo::Error> for Error {
    fn from(error: echofix_core::geo::Error) -> Self {
        Self::BadRequest(error.to_string())
    }
}

impl From<QueryRejection> for Error {
    fn from(rejection: QueryRejection) -> Self {
        Self::BadRequest(rejection.body_text())
    }
}

impl From<JsonRejection> for Error {
    fn from(rejection: JsonRejection) -> Self {
        Self::BadRequest(rejection.body_text())
    }
}

impl From<tokio::task::JoinError> for Error {
    fn from(error: tokio::task::JoinError) -> Self {
        Self::Internal(format!("a blocking task did not end well: {error}"))
    }
}
