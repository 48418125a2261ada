//! The vehicle library's own loop: a rough first pose, then each fix, carried on by odometry, is the
//! prior of the next question.

use echofix_client::Localizer;
use echofix_client::drivelog::{DriveEvent, replay};
use echofix_client::vehicle::{Fix, Vehicle, VehicleConfig};
use echofix_core::drive::{Drive, GeoPose};
use echofix_harness::prior::PriorSigma;
use echofix_harness::truth::AnswerError;
use echofix_proto::v1::GeodeticPose;
use echofix_tests::asking::{self, drawn, percentile};
use echofix_tests::grpc;
use echofix_tests::world::World;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tokio::sync::OnceCell;

async fn world() -> &'static World {
    static WORLD: OnceCell<World> = OnceCell::const_new();
    WORLD.get_or_init(World::mapped).await
}

/// What a vehicle did on a drive.
#[derive(Default)]
struct Trip {
    /// Errors of the position carried to now, ten times a second since the first fix.
    carried: Vec<AnswerError>,
    fixes: Vec<Fix>,
    /// Questions without a usable answer.
    without: usize,
}

/// Drives, asking once a second. GNSS gives a pose at the start only, or every second.
async fn drive(drive: &Drive, localizer: &Localizer, seed: u64, gnss_goes_on: bool) -> Trip {
    let (truth, mut rng) = (asking::truth(drive), ChaCha8Rng::seed_from_u64(seed));
    let mut vehicle = Vehicle::new(VehicleConfig::default(), drive.mounts.clone());
    let mut trip = Trip::default();
    let begin_us = drive.scans[0].time_us;
    let (mut next_fix_us, mut next_look_us) = (begin_us + 5_000_000, begin_us);
    for event in replay(drive) {
        let now_us = match event {
            DriveEvent::Odometry(now_us, pose) => {
                vehicle.push_odometry(now_us, pose).expect("odometry is in order");
                now_us
            }
            DriveEvent::Scan(scan) => {
                vehicle.push_scan(scan.clone()).expect("a simulated scan is sound");
                continue;
            }
            DriveEvent::Reference(_) | DriveEvent::Truth(_) => continue,
        };
        let Some(true_now) = truth.at(now_us) else { continue };
        if vehicle.position().is_none() {
            vehicle
                .push_pose(drawn(&truth, &true_now, PriorSigma::PAPER, &mut rng))
                .expect("GNSS gives a pose");
        }
        if now_us >= next_look_us {
            next_look_us = now_us + 100_000;
            trip.carried.extend(carried(&vehicle, &true_now));
        }
        if now_us >= next_fix_us {
            next_fix_us = now_us + 1_000_000;
            if gnss_goes_on {
                vehicle
                    .push_pose(drawn(&truth, &true_now, PriorSigma::PAPER, &mut rng))
                    .expect("GNSS gives a pose");
            }
            match locate(&mut vehicle, localizer).await {
                Some(fix) => trip.fixes.push(fix),
                None => trip.without += 1,
            }
        }
    }
    trip
}

/// The error of the position believed now, once there was a fix.
fn carried(vehicle: &Vehicle, truth: &GeoPose) -> Option<AnswerError> {
    let position = vehicle.position().filter(|position| position.fix_age_s.is_some())?;
    let GeoPose { at, yaw_rad, .. } = position.pose;
    Some(asking::error(&GeodeticPose { latitude_deg: at.lat_deg, longitude_deg: at.lon_deg, yaw_rad }, truth))
}

async fn locate(vehicle: &mut Vehicle, localizer: &Localizer) -> Option<Fix> {
    let question = vehicle.question().ok()?;
    let answer = localizer.ask(&question).await.expect("the service answers");
    vehicle.accept(&question, &answer).ok()
}

/// Catches a fix that is carried on wrongly (frame, time, scale), a prior whose sigma shrinks to
/// where the search loses the truth, and a wrong fix that the chain never gets out of.
#[tokio::test(flavor = "multi_thread")]
async fn a_vehicle_that_lives_on_its_own_fixes_knows_where_it_is() {
    let world = world().await;
    let localizer = grpc::localizer(&world.service);
    let trip = drive(&world.visit(450.0), &localizer, world.seed, false).await;
    let at = |fraction| percentile(trip.carried.iter().map(AnswerError::horizontal_m), fraction);
    let Trip { carried, fixes, without } = &trip;
    eprintln!(
        "{} fixes, {without} questions without; carried {} times: 50 % {:.3} m, 95 % {:.3} m, worst {:.3} m",
        fixes.len(),
        carried.len(),
        at(0.5),
        at(0.95),
        at(1.0)
    );
    assert!(fixes.len() >= 30 && fixes.len() > *without, "{} fixes, {without} without", fixes.len());
    assert!(at(0.5) < 0.3 && at(0.95) < 1.0);
    assert!(fixes.is_sorted_by_key(|fix| fix.pose.time_us) && fixes.iter().all(|fix| fix.map_epoch > 0));
}

/// Catches rough poses from outside that drag a good fix away.
#[tokio::test(flavor = "multi_thread")]
async fn gnss_going_on_does_no_harm_to_good_fixes() {
    let world = world().await;
    let localizer = grpc::localizer(&world.service);
    let trip = drive(&world.visit(200.0), &localizer, world.seed + 1, true).await;
    let error_95 = percentile(trip.carried.iter().map(AnswerError::horizontal_m), 0.95);
    assert!(trip.fixes.len() >= 10 && error_95 < 1.0, "{} fixes, 95 % {error_95:.3} m", trip.fixes.len());
}
