//! What a vehicle believes: far from the truth, known better along than across, or combined into the answer.

use std::f64::consts::TAU;
use std::time::Duration;

use echofix_core::geo::Grid;
use echofix_harness::prior::PriorSigma;
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use echofix_proto::v1::{FixStatus, GeodeticPose, LocalizeRequest, LocalizeResponse, Prior};
use echofix_tests::asking::{TruthRequest, error};
use echofix_tests::service::Service;
use echofix_tests::world::World;
use echofix_tests::{grpc, until};
use tokio::sync::OnceCell;
use tonic::transport::Channel;

type Client = LocalizationServiceClient<Channel>;

/// What the service gives a wide search: a shorter deadline leaves no time for one.
const TOO_SHORT: Duration = Duration::from_millis(99);

async fn world() -> &'static World {
    static WORLD: OnceCell<World> = OnceCell::const_new();
    WORLD.get_or_init(World::mapped).await
}

async fn answer(client: &mut Client, request: LocalizeRequest) -> LocalizeResponse {
    client.localize(request).await.expect("the question is answered").into_inner()
}

/// The question from a prior that is metres east and north and radians off the truth.
fn off(case: &TruthRequest, [east_m, north_m, yaw_rad]: [f64; 3], sigma: PriorSigma) -> LocalizeRequest {
    let grid = Grid::of(case.truth.at).expect("the town is on the map");
    let mut pose = grid.pose_from_geodetic(case.truth.at, case.truth.yaw_rad).expect("on the map");
    (pose.x_m, pose.y_m, pose.yaw_rad) = (pose.x_m + east_m, pose.y_m + north_m, pose.yaw_rad + yaw_rad);
    let (at, yaw_rad) = grid.pose_to_geodetic(&pose).expect("on the map");
    let pose = GeodeticPose { latitude_deg: at.lat_deg, longitude_deg: at.lon_deg, yaw_rad };
    from(&case.request, pose, sigma)
}

/// The question from another prior.
fn from(request: &LocalizeRequest, pose: GeodeticPose, sigma: PriorSigma) -> LocalizeRequest {
    let PriorSigma { position_m: sigma_position_m, yaw_rad: sigma_yaw_rad } = sigma;
    let prior = Prior { pose: Some(pose), sigma_position_m, sigma_yaw_rad, ..Prior::default() };
    LocalizeRequest { prior: Some(prior), ..request.clone() }
}

/// The question with its uncertainty as a covariance: the two sigmas are left out.
fn known_by(request: &LocalizeRequest, covariance: &[f64]) -> LocalizeRequest {
    let mut request = request.clone();
    let prior = request.prior.as_mut().expect("a question has a prior");
    (prior.sigma_position_m, prior.sigma_yaw_rad) = (0.0, 0.0);
    prior.covariance = covariance.to_vec();
    request
}

fn combining(request: &LocalizeRequest) -> LocalizeRequest {
    let mut request = request.clone();
    request.prior.as_mut().expect("a question has a prior").combine = true;
    request
}

fn searched_wide(answer: &LocalizeResponse) -> bool {
    answer.diagnostics.as_ref().expect("an answer has diagnostics").searched_wide
}

/// Half widths of the search: metres and radians.
fn searched(answer: &LocalizeResponse) -> [f64; 2] {
    let d = answer.diagnostics.as_ref().expect("an answer has diagnostics");
    [d.search_half_width_m, d.search_half_yaw_rad]
}

/// A prior beyond all it says of itself: more than 20 m off, in a direction of its own for each question,
/// the heading turned far.
fn astray(cases: &[TruthRequest]) -> Vec<LocalizeRequest> {
    let priors = cases.iter().zip(0_u32..).map(|(case, number)| {
        let number = f64::from(number);
        let (s, c) = (number * 2.4).sin_cos();
        let away_m = 20.0 + number % 6.0;
        off(case, [away_m * c, away_m * s, 1.0 + (number * 0.7) % (TAU - 2.0)], PriorSigma::PAPER)
    });
    priors.collect()
}

/// Catches a vehicle that stays lost because its prior claims too much, and one that gets USABLE far
/// from its prior: breaks when the wide search is left out, keeps the prior's headings or
/// is narrower, or when its answer keeps its verdict.
#[tokio::test(flavor = "multi_thread")]
async fn a_vehicle_far_astray_is_told_where_it_is_and_asks_again_from_there() {
    let world = world().await;
    let cases = world.questions(400.0, 3.0);
    let mut client = grpc::localizing(&world.service).await;
    let mut found = 0;
    for (case, request) in cases.iter().zip(astray(&cases)) {
        let reply = answer(&mut client, request).await;
        let error_m = error(reply.pose.as_ref().unwrap(), &case.truth).horizontal_m();
        eprintln!("{:?}, {error_m:.2} m: {}", reply.status(), reply.status_reason);
        assert_ne!(reply.status(), FixStatus::Usable, "{reply:?}");
        if reply.status() != FixStatus::PriorOutsideSearch {
            // Two chance hills near the prior are taken for an ambiguous street, which is not searched wide.
            let ambiguous = [FixStatus::Ambiguous, FixStatus::AmbiguousAlongTrack];
            assert!(ambiguous.contains(&reply.status()), "{reply:?}");
            continue;
        }
        assert!(error_m < 1.0, "{error_m}: {reply:?}");
        assert!(searched_wide(&reply) && !reply.protection.as_ref().unwrap().valid, "{reply:?}");
        assert!(searched(&reply)[0] > 29.9 && searched(&reply)[1] > TAU / 2.0 - 0.01, "{reply:?}");
        let again = answer(&mut client, from(&case.request, reply.pose.unwrap(), PriorSigma::PAPER)).await;
        let error_m = error(again.pose.as_ref().unwrap(), &case.truth).horizontal_m();
        assert!(!searched_wide(&again) && error_m < 0.5, "{error_m}: {again:?}");
        found += usize::from(again.status() == FixStatus::Usable);
    }
    assert!(cases.len() >= 10 && found * 5 >= cases.len() * 4, "{found} of {}", cases.len());
}

/// Catches a service that computes on for a caller who has hung up by then, and one that never searches
/// wide: breaks when the deadline is not looked at.
#[tokio::test(flavor = "multi_thread")]
async fn a_caller_in_a_hurry_is_spared_the_wide_search() {
    let world = world().await;
    let cases = world.questions(120.0, 2.0);
    let mut client = grpc::localizing(&world.service).await;
    for request in astray(&cases[..2]) {
        assert!(searched_wide(&answer(&mut client, request.clone()).await));
        // However busy the machine is, some answer comes in time.
        let reply = until("an answer comes within a short deadline", Duration::from_mins(1), async || {
            let mut hurried = tonic::Request::new(request.clone());
            hurried.set_timeout(TOO_SHORT);
            client.localize(hurried).await.ok()
        });
        let reply = reply.await.into_inner();
        assert!(!searched_wide(&reply) && reply.status() != FixStatus::Usable, "{reply:?}");
    }
}

/// Catches a service that searches wide although its operator wants none.
#[tokio::test(flavor = "multi_thread")]
async fn an_operator_can_do_without_the_wide_search() {
    let world = World::mapped_with(Service::start_with(&["locating.wide_search_m=0"])).await;
    let cases = world.questions(120.0, 2.0);
    let mut client = grpc::localizing(&world.service).await;
    for request in astray(&cases[..2]) {
        let reply = answer(&mut client, request).await;
        assert!(!searched_wide(&reply) && reply.status() != FixStatus::Usable, "{reply:?}");
    }
}

/// Catches a covariance whose order or whose root is wrong, and one that rounding makes a wider search of.
#[tokio::test(flavor = "multi_thread")]
async fn a_covariance_asks_the_same_as_its_sigmas() {
    let world = world().await;
    let mut client = grpc::localizing(&world.service).await;
    for case in world.questions(200.0, 4.0) {
        let request = case.request;
        let prior = request.prior.as_ref().unwrap();
        let (position, yaw) = (prior.sigma_position_m.powi(2), prior.sigma_yaw_rad.powi(2));
        let known = known_by(&request, &[position, 0.0, 0.0, position, 0.0, yaw]);
        let by_sigmas = answer(&mut client, request).await;
        let by_covariance = answer(&mut client, known).await;
        let apart = (0..2).map(|i| (searched(&by_sigmas)[i] - searched(&by_covariance)[i]).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-9);
        assert_eq!(by_sigmas.pose, by_covariance.pose);
        let said = |a: &LocalizeResponse| (a.status(), a.correction, a.covariance.clone(), a.protection);
        assert_eq!(said(&by_sigmas), said(&by_covariance));
    }
}

/// Catches a search as wide as the variance along east or north says, where the longest axis lies between:
/// breaks when the axes of the covariance are not looked for.
#[tokio::test(flavor = "multi_thread")]
async fn the_search_covers_the_longest_axis_of_the_covariance() {
    let world = world().await;
    let mut client = grpc::localizing(&world.service).await;
    // 1.5 m towards the north-east and 0.3 m across it: 1.08 m along either axis.
    let (long, short, yaw) = (1.5_f64.powi(2), 0.3_f64.powi(2), 0.05_f64.powi(2));
    let (same, mixed) = (0.5 * (long + short), 0.5 * (long - short));
    let mut usable = 0;
    let cases = world.questions(200.0, 4.0);
    for case in &cases {
        // 3.9 m along the long axis: 2.6 sigmas of it, and more than three of 0.9 m.
        let request = off(case, [2.76, 2.76, 0.0], PriorSigma { position_m: 0.9, yaw_rad: 0.05 });
        let narrow = answer(&mut client, request.clone()).await;
        assert_ne!(narrow.status(), FixStatus::Usable, "{narrow:?}");
        let reply = answer(&mut client, known_by(&request, &[same, mixed, 0.0, same, 0.0, yaw])).await;
        assert!((searched(&reply)[0] - 4.5).abs() < 1e-9, "{reply:?}");
        assert!(!reply.contains_prior && !searched_wide(&reply), "{reply:?}");
        let error_m = error(reply.pose.as_ref().unwrap(), &case.truth).horizontal_m();
        usable += usize::from(reply.status() == FixStatus::Usable && error_m < 0.5);
    }
    assert!(usable * 10 >= cases.len() * 9, "{usable} of {}", cases.len());
}

/// Catches an answer that contains the prior unasked, or says that it does and does not: a filter would
/// count the prior twice or not at all. Breaks when the combined covariance or pose is not used.
#[tokio::test(flavor = "multi_thread")]
async fn the_prior_is_in_the_answer_when_asked_for_and_only_then() {
    let world = world().await;
    let mut client = grpc::localizing(&world.service).await;
    let sigma = PriorSigma { position_m: 0.3, yaw_rad: 0.01 };
    let mut combined = 0;
    for case in world.questions(300.0, 4.0) {
        let request = off(&case, [0.25, -0.2, 0.008], sigma);
        let alone = answer(&mut client, request.clone()).await;
        let both = answer(&mut client, combining(&request)).await;
        assert!(!alone.contains_prior);
        assert_eq!(both.contains_prior, both.status() == FixStatus::Usable, "{both:?}");
        if !both.contains_prior {
            continue;
        }
        combined += 1;
        let prior = [sigma.position_m.powi(2), sigma.position_m.powi(2), sigma.yaw_rad.powi(2)];
        // Of the upper triangle, the diagonal.
        for (axis, index) in [0, 3, 5].into_iter().enumerate() {
            let (own, together) = (alone.covariance[index], both.covariance[index]);
            assert!(together > 0.0 && together < own && together < prior[axis], "{alone:?} {both:?}");
        }
        // Corrections of one prior: 0 is the prior, `found` what batch and map say.
        let (found, combined) = (alone.correction.unwrap(), both.correction.unwrap());
        let along =
            (combined.x_m * found.x_m + combined.y_m * found.y_m) / found.x_m.hypot(found.y_m).powi(2);
        assert!((0.5..1.0).contains(&along), "the better known counts for more: {along}");
        let levels = |a: &LocalizeResponse| a.protection.unwrap();
        assert!(levels(&both).along_m < levels(&alone).along_m, "{alone:?} {both:?}");
    }
    assert!(combined >= 5, "{combined} usable answers");
}

/// Catches a covariance that reaches the arithmetic unchecked, and a limit that what is no number passes.
#[tokio::test(flavor = "multi_thread")]
async fn an_impossible_covariance_is_refused_by_name() {
    let world = world().await;
    let sound = world.questions(120.0, 1.0).remove(0).request;
    let mut client = grpc::localizing(&world.service).await;
    let mut refusal = async |covariance: &[f64]| {
        client.localize(known_by(&sound, covariance)).await.expect_err("the question is refused")
    };
    let malformed: [&[f64]; 8] = [
        // Not positive definite: correlated by more than all, a negative variance, none, as a whole only.
        &[1.0, 2.0, 0.0, 1.0, 0.0, 0.01],
        &[1.0, 0.0, 0.0, -1.0, 0.0, 0.01],
        &[1.0, 0.0, 0.0, 0.0, 0.0, 0.01],
        &[1.0, 0.0, 0.09, 1.0, 0.09, 0.01],
        // No numbers.
        &[f64::NAN, 0.0, 0.0, 1.0, 0.0, 0.01],
        &[1.0, 0.0, 0.0, 1.0, 0.0, f64::INFINITY],
        // The wrong number of them.
        &[1.0, 0.0, 0.0, 1.0, 0.0],
        &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.01],
    ];
    for (row, covariance) in malformed.into_iter().enumerate() {
        let status = refusal(covariance).await;
        assert_eq!(grpc::field(&status), "prior.covariance", "row {row}: {status:?}");
    }
    let too_large: [(&str, &[f64]); 5] = [
        ("position", &[30.0, 0.0, 0.0, 1.0, 0.0, 0.002]),
        // Each axis within the limit, the longest one not.
        ("position", &[20.0, 15.0, 0.0, 20.0, 0.0, 0.002]),
        ("position", &[1e308, 0.0, 0.0, 1e308, 0.0, 0.002]),
        ("position", &[1e308, 9e307, 0.0, 1e308, 0.0, 0.002]),
        ("heading", &[1.0, 0.0, 0.0, 1.0, 0.0, 1.0]),
    ];
    for (what, covariance) in too_large {
        let status = refusal(covariance).await;
        assert_eq!(grpc::reason(&status), "PRIOR_TOO_UNCERTAIN", "{covariance:?}");
        assert!(status.message().contains(what), "{covariance:?}: {status:?}");
    }
}
