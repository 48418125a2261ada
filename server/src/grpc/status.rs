//! Every error of the service as a `tonic::Status` with `google.rpc` details.

use std::collections::HashMap;
use std::fmt::Display;
use std::time::Duration;

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use super::invalid_field::InvalidField;
use crate::sparse;
use crate::store;

/// The domain of every `google.rpc.ErrorInfo`.
const DOMAIN: &str = "echofix";

/// `INVALID_ARGUMENT` with `google.rpc.BadRequest`: a field of the request breaks a rule.
#[must_use]
pub fn invalid(violation: &InvalidField) -> Status {
    let details = ErrorDetails::with_bad_request_violation(&violation.field, &violation.description);
    Status::with_error_details(Code::InvalidArgument, violation.to_string(), details)
}

/// `FAILED_PRECONDITION` with `google.rpc.ErrorInfo`: the request is sound and cannot be answered.
#[must_use]
pub fn refused(reason: &'static str, message: impl Display, metadata: &[(&str, String)]) -> Status {
    let metadata: HashMap<_, _> = metadata.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect();
    let details = ErrorDetails::with_error_info(reason, DOMAIN, metadata);
    Status::with_error_details(Code::FailedPrecondition, message.to_string(), details)
}

/// `RESOURCE_EXHAUSTED` with `google.rpc.RetryInfo`: too much at once.
#[must_use]
pub fn overloaded(message: impl Display, retry_after: Duration) -> Status {
    with_retry(Code::ResourceExhausted, message, retry_after)
}

/// `UNAVAILABLE` with `google.rpc.RetryInfo`: not now.
#[must_use]
pub fn unavailable(message: impl Display, retry_after: Duration) -> Status {
    with_retry(Code::Unavailable, message, retry_after)
}

/// What the store could not do.
#[must_use]
pub fn store(error: &store::Error) -> Status {
    match error {
        store::Error::Rebuilding { .. } => unavailable(error, Duration::from_secs(5)),
        store::Error::Unknown(what) => Status::not_found(what),
        store::Error::Unusable(what) => Status::invalid_argument(what),
        store::Error::Io { .. }
        | store::Error::Stopped(_)
        | store::Error::NoRoom { .. }
        | store::Error::Broken(_)
        | store::Error::Tiles { io: Some(_), .. } => {
            if let Some(left_out) = sparse::line("the store refuses") {
                tracing::error!(%error, left_out, "the store refuses");
            }
            // The message names files of the machine; the vehicle needs the time of its next attempt only.
            unavailable("the service cannot reach its disk", Duration::from_secs(30))
        }
        store::Error::Tiles { .. } | store::Error::Damaged { .. } | store::Error::InUse(_) => {
            if let Some(left_out) = sparse::line("the store fails") {
                tracing::error!(%error, left_out, "the store fails");
            }
            failed("stored data cannot be read")
        }
    }
}

/// A task of the service that ended before its answer.
#[must_use]
pub fn torn(error: &tokio::task::JoinError) -> Status {
    tracing::error!(%error, "a task did not end as it should");
    failed("the service failed; this is a defect")
}

/// `INTERNAL` with `google.rpc.ErrorInfo`: the service is at fault. Without details the transport says it of what it was sent.
#[must_use]
pub fn failed(message: &'static str) -> Status {
    let details = ErrorDetails::with_error_info("SERVICE_FAILED", DOMAIN, HashMap::new());
    Status::with_error_details(Code::Internal, message, details)
}

/// `UNAUTHENTICATED` or `PERMISSION_DENIED` with `google.rpc.ErrorInfo`: who asks may not.
#[must_use]
pub fn denied(code: Code, reason: &'static str, message: impl Display) -> Status {
    let details = ErrorDetails::with_error_info(reason, DOMAIN, HashMap::new());
    Status::with_error_details(code, message.to_string(), details)
}

/// Nobody waits for the answer any more.
#[must_use]
pub fn gone() -> Status {
    Status::deadline_exceeded("the caller no longer waits")
}

fn with_retry(code: Code, message: impl Display, retry_after: Duration) -> Status {
    let details = ErrorDetails::with_retry_info(Some(retry_after));
    Status::with_error_details(code, message.to_string(), details)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn details_tell_what_programs_need() {
        let status = invalid(&InvalidField::new("batch.scans.range_m", "is negative"));
        assert_eq!(status.code(), Code::InvalidArgument);
        let violation = status.get_details_bad_request().unwrap().field_violations.remove(0);
        assert_eq!((&*violation.field, &*violation.description), ("batch.scans.range_m", "is negative"));

        let status = refused("NO_MAP", "nothing here", &[("tiles", "0".to_owned())]);
        let info = status.get_details_error_info().unwrap();
        assert_eq!((&*info.reason, &*info.domain, &*info.metadata["tiles"]), ("NO_MAP", "echofix", "0"));

        let status = store(&store::Error::Rebuilding { folded: 1, journaled: 2 });
        assert_eq!(status.code(), Code::Unavailable);
        assert_eq!(status.get_details_retry_info().unwrap().retry_delay, Some(Duration::from_secs(5)));

        let status = store(&store::Error::Stopped("/secret/path: I/O error".to_owned()));
        assert!(!status.message().contains("secret"), "{status}");
    }
}
