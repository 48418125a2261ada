//! What a call came back with, when not with an answer.

use std::fmt;
use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::StatusExt;

/// Why the service cannot answer, or cannot use, what it was sent. Sending the same again is of
/// no use.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum RefusalReason {
    /// The map holds nothing around the prior.
    NoMap,
    /// Taken too slowly: clutter dominates near standstill.
    TooSlow,
    /// No detections were sent.
    NoDetections,
    /// Too few detections to distinguish positions; send a longer batch.
    TooFewDetections,
    /// The prior's uncertainty asks for a larger search than the service makes.
    PriorTooUncertain,
    /// The position lies outside UTM's latitudes.
    OutsideUtm,
    /// The poses of an upload are not known well enough to map from.
    PoseTooUncertain,
    /// An upload is older than the service still takes.
    TooOld,
    /// More detections of an upload were dropped as moving than stand still; the message asks for the convention that would
    /// explain it.
    MostlyMoving,
    /// Something in an upload is in another convention than the contract's; the message asks for it.
    WrongConvention,
    /// The service no longer keeps the batch that a question of a stream counts from; ask with a whole one.
    NeedsWholeBatch,
    /// A reason this version of the library does not know.
    Other(String),
}

impl RefusalReason {
    /// The refusal of a `google.rpc.ErrorInfo` reason.
    #[must_use]
    pub fn from_reason(reason: &str) -> Self {
        match reason {
            "NO_MAP" => Self::NoMap,
            "TOO_SLOW" => Self::TooSlow,
            "NO_DETECTIONS" => Self::NoDetections,
            "TOO_FEW_DETECTIONS" => Self::TooFewDetections,
            "PRIOR_TOO_UNCERTAIN" => Self::PriorTooUncertain,
            "OUTSIDE_UTM" => Self::OutsideUtm,
            "POSE_TOO_UNCERTAIN" => Self::PoseTooUncertain,
            "TOO_OLD" => Self::TooOld,
            "MOSTLY_MOVING" => Self::MostlyMoving,
            "WRONG_CONVENTION" => Self::WrongConvention,
            "NEEDS_WHOLE_BATCH" => Self::NeedsWholeBatch,
            other => Self::Other(other.to_owned()),
        }
    }

    /// The reason as it is on the wire.
    #[must_use]
    pub fn reason(&self) -> &str {
        match self {
            Self::NoMap => "NO_MAP",
            Self::TooSlow => "TOO_SLOW",
            Self::NoDetections => "NO_DETECTIONS",
            Self::TooFewDetections => "TOO_FEW_DETECTIONS",
            Self::PriorTooUncertain => "PRIOR_TOO_UNCERTAIN",
            Self::OutsideUtm => "OUTSIDE_UTM",
            Self::PoseTooUncertain => "POSE_TOO_UNCERTAIN",
            Self::TooOld => "TOO_OLD",
            Self::MostlyMoving => "MOSTLY_MOVING",
            Self::WrongConvention => "WRONG_CONVENTION",
            Self::NeedsWholeBatch => "NEEDS_WHOLE_BATCH",
            Self::Other(reason) => reason,
        }
    }
}

impl fmt::Display for RefusalReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.reason())
    }
}

/// A field of a request that the service found malformed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldViolation {
    /// Path of the field, for instance `batch.scans.range_m`.
    pub field: String,
    /// What is wrong with it.
    pub description: String,
}

/// Why a call to the service has no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CallError {
    /// The service refuses, with a typed reason.
    #[error("the service refuses ({reason}): {message}")]
    Refused {
        /// The reason the service names.
        reason: RefusalReason,
        /// The message the service sent.
        message: String,
    },
    /// The request is malformed; the library or its configuration is at fault.
    #[error("the service calls the request malformed: {message} {}", in_words(.violations))]
    Invalid {
        /// The fields at fault.
        violations: Vec<FieldViolation>,
        /// The message the service sent.
        message: String,
    },
    /// The service sheds load.
    #[error("the service is overloaded: {message}; ask again later")]
    Overloaded {
        /// How long the service asks to wait.
        retry_after: Option<Duration>,
        /// The message the service sent.
        message: String,
    },
    /// The service cannot be reached, or is restarting.
    #[error("the service cannot be reached: {message}")]
    Unavailable {
        /// How long the service asks to wait.
        retry_after: Option<Duration>,
        /// The failure as the transport reports it.
        message: String,
    },
    /// No answer came within the deadline.
    #[error("no answer came within the deadline")]
    Deadline,
    /// The vehicle may not do this; check its certificate and role.
    #[error("the service denies access: {message}; check the vehicle's certificate and role")]
    Denied {
        /// The message the service sent.
        message: String,
    },
    /// Any other failure of the service.
    #[error("the service failed ({code:?}): {message}")]
    Failed {
        /// The status code of the call.
        code: Code,
        /// The message the service sent.
        message: String,
    },
}

impl CallError {
    /// Whether the same request may succeed later. A refused or malformed one never does.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        !matches!(self, Self::Refused { .. } | Self::Invalid { .. })
    }

    /// How long the service asks to wait before the next attempt.
    #[must_use]
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Overloaded { retry_after, .. } | Self::Unavailable { retry_after, .. } => *retry_after,
            _ => None,
        }
    }
}

impl From<&Status> for CallError {
    fn from(status: &Status) -> Self {
        let message = status.message().to_owned();
        let retry_after = status.get_details_retry_info().and_then(|info| info.retry_delay);
        match status.code() {
            Code::FailedPrecondition => {
                let info = status.get_details_error_info();
                let reason = RefusalReason::from_reason(&info.map(|i| i.reason).unwrap_or_default());
                Self::Refused { reason, message }
            }
            Code::InvalidArgument => Self::Invalid { violations: violations(status), message },
            Code::ResourceExhausted => Self::Overloaded { retry_after, message },
            // What tonic, on either side, makes of a deadline that passed.
            Code::Cancelled if message == "Timeout expired" => Self::Deadline,
            Code::Unavailable | Code::Cancelled => Self::Unavailable { retry_after, message },
            Code::DeadlineExceeded => Self::Deadline,
            // Sent under another name it would be another upload; access that is granted later does not help this one.
            Code::PermissionDenied if named(status).is_some_and(|name| name == NOT_THE_CONTRIBUTOR) => {
                Self::Refused { reason: RefusalReason::Other(NOT_THE_CONTRIBUTOR.to_owned()), message }
            }
            Code::Unauthenticated | Code::PermissionDenied => Self::Denied { message },
            // A connection that breaks within a call shows as an unknown error with a source.
            Code::Unknown if std::error::Error::source(status).is_some() => {
                Self::Unavailable { retry_after, message }
            }
            code => Self::Failed { code, message },
        }
    }
}

/// The reason by which a service refuses an upload under another name than its caller's.
const NOT_THE_CONTRIBUTOR: &str = "NOT_THE_CONTRIBUTOR";

fn named(status: &Status) -> Option<String> {
    status.get_details_error_info().map(|info| info.reason)
}

fn violations(status: &Status) -> Vec<FieldViolation> {
    let details = status.get_details_bad_request();
    let fields = details.map(|bad| bad.field_violations).unwrap_or_default();
    fields.into_iter().map(|f| FieldViolation { field: f.field, description: f.description }).collect()
}

fn in_words(violations: &[FieldViolation]) -> String {
    let each: Vec<_> = violations.iter().map(|v| format!("[{}: {}]", v.field, v.description)).collect();
    each.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use tonic_types::ErrorDetails;

    #[test]
    fn reasons_of_the_contract_are_typed_and_new_ones_kept() {
        for reason in [
            "NO_MAP",
            "TOO_SLOW",
            "NO_DETECTIONS",
            "TOO_FEW_DETECTIONS",
            "PRIOR_TOO_UNCERTAIN",
            "OUTSIDE_UTM",
            "POSE_TOO_UNCERTAIN",
            "TOO_OLD",
            "MOSTLY_MOVING",
            "WRONG_CONVENTION",
            "NEEDS_WHOLE_BATCH",
        ] {
            let details = ErrorDetails::with_error_info(reason, "echofix", []);
            let status = Status::with_error_details(Code::FailedPrecondition, "no", details);
            let error = CallError::from(&status);
            let CallError::Refused { reason: typed, .. } = &error else { panic!("{error}") };
            assert!(!matches!(typed, RefusalReason::Other(_)), "{reason}");
            assert_eq!(typed.reason(), reason);
            assert!(!error.is_transient());
        }
        assert_eq!(RefusalReason::from_reason("NEW"), RefusalReason::Other("NEW".into()));
    }

    #[test]
    fn malformed_requests_name_their_fields() {
        let details = ErrorDetails::with_bad_request_violation("batch.scans.range_m", "is negative");
        let status = Status::with_error_details(Code::InvalidArgument, "bad batch", details);
        let error = CallError::from(&status);
        assert!(error.to_string().contains("[batch.scans.range_m: is negative]"), "{error}");
        assert!(!error.is_transient());
    }

    #[test]
    fn shed_load_says_how_long_to_wait() {
        let details = ErrorDetails::with_retry_info(Some(Duration::from_secs(3)));
        let status = Status::with_error_details(Code::ResourceExhausted, "full", details);
        let error = CallError::from(&status);
        assert_eq!(error.retry_after(), Some(Duration::from_secs(3)));
        assert!(error.is_transient());
    }
}
