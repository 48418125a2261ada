//! What any gRPC tool expects of a service: health and reflection.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use echofix_tests::grpc;
use echofix_tests::service::Service;
use tonic::Code;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_health::pb::{HealthCheckRequest, HealthCheckResponse};
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

const SERVICES: [&str; 3] =
    ["echofix.v1.LocalizationService", "echofix.v1.MapService", "echofix.v1.MappingService"];

/// Catches a service that is registered but never set to serving, and one that calls itself healthy
/// while it ends.
#[tokio::test(flavor = "multi_thread")]
async fn every_service_is_healthy_until_the_end() {
    let mut service = Service::start();
    let mut health = HealthClient::new(grpc::connect(&service).await);
    for name in ["", SERVICES[0], SERVICES[1], SERVICES[2]] {
        let answer = health.check(HealthCheckRequest { service: name.to_owned() }).await;
        let answer =
            answer.unwrap_or_else(|status| panic!("`{name}` has no health: {status:?}")).into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "`{name}`");
    }
    let unknown = health.check(HealthCheckRequest { service: "echofix.v1.Nothing".to_owned() }).await;
    assert_eq!(unknown.expect_err("it does not exist").code(), Code::NotFound);

    let mut watched =
        health.watch(HealthCheckRequest { service: SERVICES[0].to_owned() }).await.unwrap().into_inner();
    assert_eq!(watched.message().await.unwrap().unwrap().status(), ServingStatus::Serving);
    service.ask_to_end();
    let last: Option<HealthCheckResponse> =
        watched.message().await.expect("the watcher gets a status before the end");
    assert_eq!(last.expect("the watcher gets a status before the end").status(), ServingStatus::NotServing);
    drop((watched, health));
    assert_eq!(service.ended().code(), Some(0));
}

async fn reflect(service: &Service, request: MessageRequest) -> MessageResponse {
    let mut client = ServerReflectionClient::new(grpc::connect(service).await);
    let request = ServerReflectionRequest { host: String::new(), message_request: Some(request) };
    let answers =
        client.server_reflection_info(tokio_stream::iter([request])).await.expect("there is reflection");
    let answer = answers.into_inner().message().await.unwrap().expect("a question has an answer");
    answer.message_response.unwrap()
}

/// Catches a service that tools cannot discover.
#[tokio::test(flavor = "multi_thread")]
async fn reflection_lists_every_service_and_describes_each() {
    let service = Service::start();
    let MessageResponse::ListServicesResponse(list) =
        reflect(&service, MessageRequest::ListServices(String::new())).await
    else {
        panic!("no list of services");
    };
    let names: Vec<_> = list.service.iter().map(|service| service.name.as_str()).collect();
    for name in SERVICES.into_iter().chain(["grpc.health.v1.Health", "grpc.reflection.v1.ServerReflection"]) {
        assert!(names.contains(&name), "{name} is not among {names:?}");
    }
    for name in SERVICES {
        let described = reflect(&service, MessageRequest::FileContainingSymbol(name.to_owned())).await;
        let MessageResponse::FileDescriptorResponse(files) = described else {
            panic!("{name}: {described:?}")
        };
        assert!(!files.file_descriptor_proto.is_empty());
    }
}
