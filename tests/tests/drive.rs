//! Two vehicles map a town; on another day a third one asks where it is.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use echofix_core::geo::{Grid, LatLon};
use echofix_harness::truth::AnswerError;
use echofix_proto::v1::localize_stream_response::Outcome;
use echofix_proto::v1::{
    Diagnostics, FixStatus, LocalizeRequest, LocalizeResponse, LocalizeStreamRequest, ProtectionLevel,
    Requirement,
};
use echofix_tests::asking::{self, TruthRequest, percentile};
use echofix_tests::grpc;
use echofix_tests::world::World;
use tokio::sync::OnceCell;
use tonic::Code;
use tonic_types::RpcStatusExt as _;

/// A drive through the mapped town, asked once for all tests.
struct Visit {
    world: World,
    cases: Vec<TruthRequest>,
    answers: Vec<LocalizeResponse>,
}

async fn visit() -> &'static Visit {
    static VISIT: OnceCell<Visit> = OnceCell::const_new();
    let make = async || {
        let world = World::mapped().await;
        let cases = world.questions(420.0, 1.2);
        let answers = ask_all(&world, &cases).await;
        Visit { world, cases, answers }
    };
    VISIT.get_or_init(make).await
}

async fn ask(world: &World, request: LocalizeRequest) -> LocalizeResponse {
    grpc::localizing(&world.service)
        .await
        .localize(request)
        .await
        .expect("the question has an answer")
        .into_inner()
}

/// The answers to all questions, in order.
async fn ask_all(world: &World, cases: &[TruthRequest]) -> Vec<LocalizeResponse> {
    let client = grpc::localizing(&world.service).await;
    let ask = |request: LocalizeRequest| {
        let mut client = client.clone();
        tokio::spawn(async move {
            client.localize(request).await.expect("the question has an answer").into_inner()
        })
    };
    let asked: Vec<_> = cases.iter().map(|case| ask(case.request.clone())).collect();
    let mut answers = Vec::new();
    for answer in asked {
        answers.push(answer.await.expect("asking does not break down"));
    }
    answers
}

fn error(answer: &LocalizeResponse, case: &TruthRequest) -> AnswerError {
    asking::error(&answer.pose.expect("an answer has a pose"), &case.truth)
}

/// Catches whatever moves or turns the batch against the map: mounts left out, the convergence
/// forgotten on the way out, radial speeds of the wrong sign; and a verdict that has become too shy or
/// too bold.
#[tokio::test(flavor = "multi_thread")]
async fn usable_fixes_are_as_accurate_as_the_papers() {
    let Visit { cases, answers, .. } = visit().await;
    assert!(cases.len() >= 30, "{} questions", cases.len());
    let usable: Vec<_> = answers.iter().zip(cases).filter(|(a, _)| a.status() == FixStatus::Usable).collect();
    let errors: Vec<AnswerError> = usable.iter().map(|(answer, case)| error(answer, case)).collect();
    let at = |fraction| percentile(errors.iter().map(AnswerError::horizontal_m), fraction);
    let yaw_deg = percentile(errors.iter().map(|e| e.yaw_rad.abs().to_degrees()), 0.95);
    eprintln!(
        "{} of {} usable; error 50 % {:.3} m, 95 % {:.3} m and {yaw_deg:.3} deg, worst {:.3} m",
        usable.len(),
        cases.len(),
        at(0.5),
        at(0.95),
        at(1.0)
    );
    assert!(
        usable.len() * 10 >= cases.len() * 7,
        "{:?}",
        answers.iter().map(|a| &a.status_reason).collect::<Vec<_>>()
    );
    assert!(at(0.5) < 0.3 && at(0.95) < 0.44 && yaw_deg < 0.59);
    for ((answer, _), error) in usable.iter().zip(&errors) {
        let level = answer.protection.expect("a usable answer is protected");
        let within = error.along_m.abs() <= level.along_m && error.cross_m.abs() <= level.cross_m;
        assert!(within && error.yaw_rad.abs() <= level.yaw_rad, "{error:?} beyond {level:?}");
    }
}

/// Catches an answer that a vehicle could not judge: fields left out, swapped or contradicting each
/// other.
#[tokio::test(flavor = "multi_thread")]
async fn an_answer_carries_all_a_vehicle_needs_to_judge_it() {
    let Visit { world, cases, answers } = visit().await;
    for (answer, case) in answers.iter().zip(cases) {
        frames_agree(answer, &case.request);
        bounds_make_sense(answer);
        facts_make_sense(answer, world);
    }
}

/// Position, grid position and correction tell the same pose.
fn frames_agree(answer: &LocalizeResponse, request: &LocalizeRequest) {
    assert_eq!(answer.time_us, request.batch.as_ref().unwrap().reference_time_us);
    let (pose, utm, correction) = (answer.pose.unwrap(), answer.utm.unwrap(), answer.correction.unwrap());
    let prior = request.prior.as_ref().and_then(|prior| prior.pose).unwrap();
    let grid = Grid::of(LatLon { lat_deg: prior.latitude_deg, lon_deg: prior.longitude_deg }).unwrap();
    assert_eq!(utm.epsg, u32::from(grid.zone().epsg()));
    let on_grid = |p: echofix_proto::v1::GeodeticPose| {
        let at = LatLon { lat_deg: p.latitude_deg, lon_deg: p.longitude_deg };
        grid.pose_from_geodetic(at, p.yaw_rad).unwrap()
    };
    let (answered, believed) = (on_grid(pose), on_grid(prior));
    let pairs = [
        (answered.x_m, utm.easting_m),
        (answered.y_m, utm.northing_m),
        (answered.yaw_rad, utm.yaw_rad),
        (believed.x_m + correction.x_m, utm.easting_m),
        (believed.y_m + correction.y_m, utm.northing_m),
    ];
    for (one, other) in pairs {
        assert!((one - other).abs() < 1e-3, "{pairs:?}");
    }
    let turned = echofix_core::pose::wrap_angle(believed.yaw_rad + correction.yaw_rad - utm.yaw_rad);
    assert!(turned.abs() < 1e-6, "{turned}");
}

/// Covariance, protection and alternatives are what they claim to be.
fn bounds_make_sense(answer: &LocalizeResponse) {
    let [xx, xy, xt, yy, yt, tt] = answer.covariance[..] else {
        // Nothing holds the pose in some direction: no number, and no use.
        assert!(answer.covariance.is_empty() && answer.protection.is_none(), "{answer:?}");
        return assert_ne!(answer.status(), FixStatus::Usable);
    };
    assert!(xx > 0.0 && yy > 0.0 && tt > 0.0, "{:?}", answer.covariance);
    assert!(xy * xy <= xx * yy && xt * xt <= xx * tt && yt * yt <= yy * tt, "{:?}", answer.covariance);
    let ProtectionLevel { along_m, cross_m, yaw_rad, integrity_risk, valid } = answer.protection.unwrap();
    assert_eq!(valid, answer.status() == FixStatus::Usable);
    assert!((integrity_risk - 1e-3).abs() < 1e-12);
    if valid {
        // More than three sigma for a risk of one in a thousand.
        let sigma_m = (xx + yy).sqrt();
        assert!(along_m.hypot(cross_m) > 3.0 * sigma_m && along_m.hypot(cross_m) < 10.0 * sigma_m);
        assert!(yaw_rad > 3.0 * tt.sqrt());
    }
    let scores: Vec<f64> = answer.alternatives.iter().map(|a| a.relative_score).collect();
    assert!(
        scores.is_sorted_by(|a, b| a >= b) && scores.iter().all(|s| (0.0..=1.0).contains(s)),
        "{scores:?}"
    );
    let best = answer.correction.unwrap();
    for other in answer.alternatives.iter().filter_map(|a| a.correction) {
        assert!(
            (other.x_m - best.x_m).hypot(other.y_m - best.y_m) >= 1.0,
            "{other:?} is the answer {best:?}"
        );
    }
}

/// Diagnostics and map state belong to this question and this map.
fn facts_make_sense(answer: &LocalizeResponse, world: &World) {
    let facts = answer.diagnostics.unwrap();
    assert!(facts.detections_used > 0 && facts.detections_used <= facts.detections_sent, "{facts:?}");
    assert!(facts.batch_blocks > 0 && facts.batch_blocks <= facts.detections_used, "{facts:?}");
    assert!((0.5..=5.1).contains(&facts.batch_duration_s), "{facts:?}");
    assert!((1.0..=80.0).contains(&facts.travelled_m), "{facts:?}");
    assert!((6.0..=6.2).contains(&facts.search_half_width_m), "three sigma of 2 m: {facts:?}");
    assert!(
        (8.9..=10.1).contains(&facts.search_half_yaw_rad.to_degrees()),
        "three sigma of 3 deg: {facts:?}"
    );
    assert!((0.0..=1.0).contains(&facts.matched_fraction) && facts.score > 0.0 && facts.align_ms > 0.0);
    let map = answer.map.unwrap();
    let newest = world.answers.iter().map(|a| a.epoch).max().unwrap();
    // Day 0 of the town: nothing newer was mapped.
    assert_eq!((map.epoch, map.newest_day), (newest, 20_454));
    assert!(map.coverage > 0.5 && map.tiles > 0 && map.cells > 1_000, "{map:?}");
    assert!(
        !answer.algorithm.is_empty() && !answer.calibration.is_empty() && !answer.status_reason.is_empty()
    );
}

/// Catches a requirement that is decoded and then forgotten.
#[tokio::test(flavor = "multi_thread")]
async fn what_the_vehicle_requires_decides_what_is_usable() {
    let Visit { world, cases, answers } = visit().await;
    let usable = answers.iter().zip(cases).find(|(answer, _)| answer.status() == FixStatus::Usable);
    let (answer, case) = usable.expect("one of the answers is usable");
    let require = |integrity_risk, alert_limit_m| {
        let requirement = Some(Requirement { integrity_risk, alert_limit_m });
        ask(world, LocalizeRequest { requirement, ..case.request.clone() })
    };
    let level = answer.protection.unwrap();
    let horizontal_m = level.along_m.hypot(level.cross_m);
    assert_eq!(require(0.0, horizontal_m * 0.9).await.status(), FixStatus::AboveAlertLimit);
    assert_eq!(require(0.0, horizontal_m * 1.1).await.status(), FixStatus::Usable);
    let rarer = require(1e-6, 0.0).await.protection.unwrap();
    assert!((rarer.integrity_risk - 1e-6).abs() < 1e-15);
    assert!(rarer.along_m > level.along_m && rarer.cross_m > level.cross_m && rarer.yaw_rad > level.yaw_rad);
}

/// Catches a verdict that trusts the best pose within the search although the true one lies outside.
#[tokio::test(flavor = "multi_thread")]
async fn a_prior_beyond_its_own_sigma_is_never_answered_with_a_usable_fix_elsewhere() {
    let Visit { world, cases, .. } = visit().await;
    let mut wrong = 0;
    for case in cases.iter().step_by(4) {
        let mut request = case.request.clone();
        let prior = request.prior.as_mut().unwrap();
        let pose = prior.pose.as_mut().unwrap();
        // 15 m to the side, where 3 m are searched.
        pose.latitude_deg = case.truth.at.lat_deg + 10.6 / 111_000.0;
        pose.longitude_deg = case.truth.at.lon_deg + 10.6 / 96_000.0;
        prior.sigma_position_m = 1.0;
        let answer = ask(world, request).await;
        wrong += u32::from(answer.status() == FixStatus::Usable && error(&answer, case).horizontal_m() > 1.0);
    }
    assert_eq!(wrong, 0, "answers called usable that are metres away from the truth");
}

/// Catches a stream that answers other than the single call does, out of order, or ends when one
/// question is refused.
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_answers_as_single_calls_do_and_outlives_refusals() {
    let Visit { world, cases, answers } = visit().await;
    let (cases, single) = (&cases[..6], answers.iter().take(6).cloned().map(untimed).collect::<Vec<_>>());
    let mut asked = Vec::new();
    for (number, case) in (0..).zip(cases) {
        for (sequence, request) in
            [(2 * number, case.request.clone()), (2 * number + 1, refused(number, case))]
        {
            asked.push(LocalizeStreamRequest { sequence, request: Some(request), ..Default::default() });
        }
    }
    let mut client = grpc::localizing(&world.service).await;
    let stream = client.localize_stream(tokio_stream::iter(asked)).await.expect("the stream opens");
    let mut stream = stream.into_inner();
    for number in 0..2 * cases.len() as u64 {
        let answer =
            stream.message().await.expect("the stream goes on").expect("every question has an answer");
        assert_eq!(answer.sequence, number);
        match answer.outcome.expect("an answer or a refusal") {
            Outcome::Response(answer) => {
                assert_eq!(number % 2, 0);
                assert_eq!(untimed(answer), single[number as usize / 2]);
            }
            Outcome::Error(status) => {
                assert_eq!(number % 2, 1, "{status:?}");
                if number % 4 == 1 {
                    assert_eq!(status.code, i32::from(Code::FailedPrecondition));
                    assert_eq!(status.get_details_error_info().unwrap().reason, "PRIOR_TOO_UNCERTAIN");
                } else {
                    assert_eq!(status.code, i32::from(Code::InvalidArgument));
                    let bad = status.get_details_bad_request().unwrap();
                    assert_eq!(bad.field_violations[0].field, "prior");
                }
            }
        }
    }
    assert!(stream.message().await.expect("the stream ends well").is_none());
}

/// A question that cannot be answered: by turns refused and malformed.
fn refused(number: u64, case: &TruthRequest) -> LocalizeRequest {
    let mut request = case.request.clone();
    if number.is_multiple_of(2) {
        request.prior.as_mut().unwrap().sigma_position_m = 1e3;
    } else {
        request.prior = None;
    }
    request
}

/// The answer without what differs from call to call.
fn untimed(answer: LocalizeResponse) -> LocalizeResponse {
    let diagnostics =
        answer.diagnostics.map(|d| Diagnostics { queued_ms: 0.0, window_ms: 0.0, align_ms: 0.0, ..d });
    LocalizeResponse { diagnostics, ..answer }
}
