//! What a caller sent and nobody can read is the caller's fault, and is told so.
//!
//! gRPC's libraries answer INTERNAL to bytes that are no message, are not packed as they say, or end too early. To a vehicle
//! that looks like a defect of the service, and it sends the same bytes again. A failure of the service's own carries
//! details, which tells the two apart.

use std::sync::Arc;

use axum::http::Response;
use tonic::body::Body;
use tonic::{Code, Status};

use super::invalid_field::InvalidField;
use super::status;
use crate::metrics::{Metrics, OutcomeLabel};
use crate::rpc_code::word;

/// How the transport begins what it says of messages that unpack to more than is taken.
const UNPACKS_TOO_FAR: &str = "Error decompressing";

/// The status a caller gets for one that the transport made of what it sent.
pub(super) fn told(status: Status) -> Status {
    let unread = match status.code() {
        Code::Internal => status.details().is_empty(),
        Code::ResourceExhausted => status.message().starts_with(UNPACKS_TOO_FAR),
        _ => false,
    };
    if !unread {
        return status;
    }
    let described = format!("cannot be read: {}; send what the contract says", status.message());
    status::invalid(&InvalidField::new("message", described))
}

/// Tells callers of a port what is their own fault, and counts what is refused in `metrics`.
pub fn tell(
    metrics: Arc<Metrics>,
) -> impl Fn(Response<Body>) -> Response<Body> + Clone + Send + Sync + 'static {
    move |response| {
        // A call that fails before its first answer has its status among the headers.
        let Some(status) = Status::from_header_map(response.headers()) else { return response };
        let status = told(status);
        let outcome = word(status.code());
        metrics.refused.get_or_create(&OutcomeLabel { outcome }).inc();
        if status.code() == Code::InvalidArgument { status.into_http() } else { response }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tonic_types::StatusExt;

    #[test]
    fn what_the_service_itself_fails_at_stays_its_own_fault() {
        let unread = told(Status::internal("failed to decode Protobuf message: buffer underflow"));
        assert_eq!(unread.code(), Code::InvalidArgument);
        let violation = unread.get_details_bad_request().unwrap().field_violations.remove(0);
        assert!(violation.field == "message" && violation.description.contains("underflow"), "{violation:?}");
        assert_eq!(told(status::failed("stored data cannot be read")).code(), Code::Internal);
        let busy = status::overloaded("too many", std::time::Duration::from_secs(1));
        assert_eq!(told(busy).code(), Code::ResourceExhausted);
    }
}
