//! Clients of the vehicles' port, and refusals taken apart.

use echofix_client::{Localizer, service};
use echofix_harness::replay::patient_localizer;
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use echofix_proto::v1::map_service_client::MapServiceClient;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use tonic::transport::Channel;
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::service::Service;

/// Connects to the vehicles' port.
pub async fn connect(service: &Service) -> Channel {
    let endpoint = service::ServiceAddress::at(&service.grpc).endpoint().expect("the address is one");
    endpoint
        .transport
        .connect()
        .await
        .unwrap_or_else(|error| panic!("cannot connect to {}: {error}", service.grpc))
}

/// A client that localizes.
pub async fn localizing(service: &Service) -> LocalizationServiceClient<Channel> {
    LocalizationServiceClient::new(connect(service).await)
}

/// A client that contributes.
pub async fn mapping(service: &Service) -> MappingServiceClient<Channel> {
    MappingServiceClient::new(connect(service).await)
}

/// A client that contributes over a connection that is open.
pub fn mapping_on(channel: Channel) -> MappingServiceClient<Channel> {
    MappingServiceClient::new(channel)
}

/// A client that reads the map.
pub async fn reading(service: &Service) -> MapServiceClient<Channel> {
    MapServiceClient::new(connect(service).await)
}

/// The vehicle library's localizer, more patient than a vehicle.
pub fn localizer(service: &Service) -> Localizer {
    patient_localizer(&service.grpc).expect("the address is one")
}

/// The reason of a `FAILED_PRECONDITION`, in the service's domain.
pub fn reason(status: &Status) -> String {
    assert_eq!(status.code(), Code::FailedPrecondition, "{status:?}");
    let info = status.get_details_error_info().unwrap_or_else(|| panic!("no ErrorInfo in {status:?}"));
    assert_eq!(info.domain, "echofix");
    assert!(!status.message().is_empty(), "a refusal says why in words, too");
    info.reason
}

/// The field that an `INVALID_ARGUMENT` names.
pub fn field(status: &Status) -> String {
    assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
    let bad = status.get_details_bad_request().unwrap_or_else(|| panic!("no BadRequest in {status:?}"));
    let [violation] = &bad.field_violations[..] else { panic!("one field is at fault: {status:?}") };
    assert!(!violation.description.is_empty(), "a violation says what is wrong: {status:?}");
    violation.field.clone()
}
