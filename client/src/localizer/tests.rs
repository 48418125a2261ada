//! Asking services that answer, refuse, shed and hang.

use super::*;
use crate::refusal::RefusalReason;
use crate::testing::T0;
use crate::testing::service::{Behaviour, MockService};
use crate::vehicle::{Vehicle, VehicleConfig};
use echofix_core::drive::GeoPose;
use echofix_core::pose::Pose2;
use echofix_core::scan::{Mount, Scan};
use tonic::transport::Endpoint;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

fn vehicle() -> Vehicle {
    let mut vehicle = Vehicle::new(VehicleConfig::default(), vec![Mount::IDENTITY]);
    for i in 0..20 {
        let time_us = T0 + i * 100_000;
        vehicle.push_odometry(time_us, Pose2::new(i as f64, 0.0, 0.0)).unwrap();
        let scan = Scan { time_us, range_m: vec![9.0], azimuth_rad: vec![0.1], ..Scan::default() };
        vehicle.push_scan(scan).unwrap();
    }
    let pose = GeoPose { time_us: T0 + 1_000_000, sigma_position_m: 3.0, ..GeoPose::default() };
    vehicle.push_pose(pose).unwrap();
    vehicle
}

async fn localizer(script: Vec<Behaviour>) -> (Localizer, MockService) {
    let service = MockService::start(script).await;
    let backoff = BackoffPolicy { initial: Duration::from_millis(5), max: Duration::from_millis(20) };
    let options = LocalizerOptions { deadline: Duration::from_secs(1), backoff };
    (Localizer::new(service.endpoint(), options), service)
}

#[tokio::test]
async fn a_moment_of_trouble_is_retried_and_the_answer_accepted() {
    let script = vec![
        Behaviour::Fail(Status::unavailable("restarting")),
        Behaviour::Fail(Status::resource_exhausted("busy")),
    ];
    let (localizer, service) = localizer(script).await;
    let mut vehicle = vehicle();
    let question = vehicle.question().unwrap();
    let answer = localizer.ask(&question).await.unwrap();
    vehicle.accept(&question, &answer).unwrap();
    assert_eq!(service.call_times().len(), 3);
}

#[tokio::test]
async fn a_refusal_is_typed_and_not_repeated() {
    let info = ErrorDetails::with_error_info("NO_MAP", "echofix", []);
    let refusal = Status::with_error_details(Code::FailedPrecondition, "nothing there", info);
    let (localizer, service) = localizer(vec![Behaviour::Fail(refusal)]).await;
    let error = localizer.ask(&vehicle().question().unwrap()).await.unwrap_err();
    assert!(matches!(error, CallError::Refused { reason: RefusalReason::NoMap, .. }), "{error}");
    assert_eq!(service.call_times().len(), 1);
}

#[tokio::test]
async fn a_service_that_hangs_costs_no_more_than_the_deadline() {
    let (localizer, _service) = localizer(vec![Behaviour::Hang]).await;
    let asked = Instant::now();
    let error = localizer.ask(&vehicle().question().unwrap()).await.unwrap_err();
    assert_eq!(error, CallError::Deadline);
    assert!(asked.elapsed() < Duration::from_secs(5));
    localizer.ask(&vehicle().question().unwrap()).await.unwrap();
}

#[tokio::test]
async fn a_wish_to_wait_beyond_the_deadline_ends_the_asking() {
    let wish = ErrorDetails::with_retry_info(Some(Duration::from_secs(5)));
    let shed = Status::with_error_details(Code::ResourceExhausted, "full", wish);
    let (localizer, service) = localizer(vec![Behaviour::Fail(shed)]).await;
    let error = localizer.ask(&vehicle().question().unwrap()).await.unwrap_err();
    assert_eq!(error.retry_after(), Some(Duration::from_secs(5)));
    assert_eq!(service.call_times().len(), 1);
}

#[tokio::test]
async fn nobody_at_the_address_is_told() {
    let nobody = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let endpoint = Endpoint::from_shared(format!("http://{nobody}")).unwrap();
    let options = LocalizerOptions { deadline: Duration::from_millis(200), ..LocalizerOptions::default() };
    let error = Localizer::new(endpoint, options).ask(&vehicle().question().unwrap()).await.unwrap_err();
    assert!(matches!(error, CallError::Unavailable { .. }), "{error}");
}
