//! Streams to services that keep batches, lose them, break and know of none.

use super::*;
use crate::LocalizerOptions;
use crate::testing::T0;
use crate::testing::service::{Behaviour, MockService};
use crate::vehicle::{Vehicle, VehicleConfig};
use echofix_core::drive::GeoPose;
use echofix_core::pose::Pose2;
use echofix_core::scan::{Mount, Scan};
use tonic_types::{ErrorDetails, StatusExt};

/// A question each second of a drive.
fn questions(count: i64) -> Vec<LocalizationQuestion> {
    let mut vehicle = Vehicle::new(VehicleConfig::default(), vec![Mount::IDENTITY]);
    let mut questions = Vec::new();
    for i in 0..50 + 10 * count {
        let time_us = T0 + i * 100_000;
        vehicle.push_odometry(time_us, Pose2::new(0.83 * i as f64, 0.0, 0.0)).unwrap();
        let range_m: Vec<f32> = (0..100).map(|n| 5.0 + ((7 * n + i) % 40) as f32).collect();
        let azimuth_rad = vec![0.1; range_m.len()];
        vehicle.push_scan(Scan { time_us, range_m, azimuth_rad, ..Scan::default() }).unwrap();
        if i == 10 {
            vehicle.push_pose(GeoPose { time_us, sigma_position_m: 3.0, ..GeoPose::default() }).unwrap();
        }
        if i >= 50 && i % 10 == 0 {
            questions.push(vehicle.question().unwrap());
        }
    }
    questions
}

async fn asked(script: Vec<Behaviour>, forgetful: bool) -> (StreamTraffic, Vec<v1::Batch>, Vec<v1::Batch>) {
    let service = MockService::start(script).await;
    if forgetful {
        service.keep_nothing();
    }
    let mut stream = Localizer::new(service.endpoint(), LocalizerOptions::default()).stream();
    let questions = questions(6);
    for question in &questions {
        let answer = stream.ask(question).await.unwrap();
        assert_eq!(answer.time_us, question.time_us());
    }
    let whole = questions.iter().filter_map(|question| question.request.batch.clone()).collect();
    (stream.traffic(), service.batches(), whole)
}

/// Catches: questions that are whole where the service keeps their batches, and a batch that becomes another one on the way.
#[tokio::test]
async fn only_what_is_new_is_sent_and_the_service_has_all_of_it() {
    let (less, made, whole) = asked(Vec::new(), false).await;
    assert_eq!((less.whole, less.deltas), (1, 5));
    assert_eq!(made, whole);
    // An older service, or one without room: it never hears a delta.
    let (all, made, whole) = asked(Vec::new(), true).await;
    assert_eq!((all.whole, all.deltas), (6, 0));
    assert_eq!(made, whole);
    let a_delta = (less.bytes - all.bytes / 6) / 5;
    assert!(4 * a_delta < all.bytes / 6, "{a_delta} bytes of {}", all.bytes / 6);
}

/// Catches: a question that is lost where the service has dropped the batch, or where the stream breaks.
#[tokio::test]
async fn a_batch_or_a_stream_that_is_gone_loses_no_question() {
    let info = ErrorDetails::with_error_info("NEEDS_WHOLE_BATCH", "echofix", []);
    let gone = Status::with_error_details(Code::FailedPrecondition, "send a whole one", info);
    let script = vec![Behaviour::Accept, Behaviour::Accept, Behaviour::Fail(gone), Behaviour::Accept];
    let (traffic, made, whole) = asked(script, false).await;
    assert_eq!((traffic.whole, traffic.deltas), (2, 5), "one delta in vain");
    assert_eq!(made, whole);
    let script = vec![Behaviour::Accept, Behaviour::Accept, Behaviour::LoseAnswer];
    let (traffic, made, whole) = asked(script, false).await;
    assert_eq!((traffic.whole, traffic.deltas), (2, 5));
    assert_eq!(made, whole);
}

/// Catches: a refusal of a stream that is not typed as that of a single call is.
#[tokio::test]
async fn a_refusal_is_typed_and_the_stream_goes_on() {
    let info = ErrorDetails::with_error_info("NO_MAP", "echofix", []);
    let refusal = Status::with_error_details(Code::FailedPrecondition, "nothing there", info);
    let service = MockService::start(vec![Behaviour::Fail(refusal)]).await;
    let mut stream = Localizer::new(service.endpoint(), LocalizerOptions::default()).stream();
    let questions = questions(2);
    let error = stream.ask(&questions[0]).await.unwrap_err();
    assert!(matches!(error, CallError::Refused { reason: RefusalReason::NoMap, .. }), "{error}");
    stream.ask(&questions[1]).await.unwrap();
}
