//! A vehicle driving east, asked what it would ask.

use super::*;
use crate::testing::{T0, usable_answer};
use echofix_core::geo::LatLon;

const START: LatLon = LatLon { lat_deg: 30.0, lon_deg: -97.0 };

fn gnss(time_us: i64, sigma_position_m: f64, sigma_yaw_rad: f64) -> GeoPose {
    GeoPose { time_us, at: START, yaw_rad: 0.0, sigma_position_m, sigma_yaw_rad }
}

/// Drives straight for a time, odometry and one scan every 0.1 s.
fn driven(speed_mps: f64, seconds: i64) -> Vehicle {
    let mut vehicle = Vehicle::new(VehicleConfig::default(), vec![Mount::IDENTITY]);
    drive(&mut vehicle, speed_mps, 0, seconds * 10);
    vehicle
}

fn drive(vehicle: &mut Vehicle, speed_mps: f64, from: i64, to: i64) {
    for i in from..=to {
        let time_us = T0 + i * 100_000;
        vehicle.push_odometry(time_us, Pose2::new(speed_mps * i as f64 * 0.1, 0.0, 0.0)).unwrap();
        let scan = Scan { time_us, range_m: vec![9.0; 3], azimuth_rad: vec![0.1; 3], ..Scan::default() };
        vehicle.push_scan(scan).unwrap();
    }
}

#[test]
fn a_question_is_the_window_with_a_prior_at_its_newest_scan() {
    let mut vehicle = driven(10.0, 8);
    vehicle.push_pose(gnss(T0 + 7_000_000, 2.0, 0.02)).unwrap();
    let question = vehicle.question().unwrap();
    let v1::LocalizeRequest { batch, prior, .. } = question.request;
    let (batch, prior) = (batch.unwrap(), prior.unwrap());
    assert_eq!(batch.reference_time_us, T0 + 8_000_000);
    let (scans, odometry) = (batch.scans.unwrap(), batch.odometry.unwrap());
    assert_eq!(scans.sensor.len(), 51);
    assert_eq!((scans.time_offset_us[0], scans.time_offset_us[50]), (-5_000_000, 0));
    assert_eq!((odometry.time_offset_us[0], *odometry.time_offset_us.last().unwrap()), (-5_000_000, 0));
    assert!(scans.radial_speed_mps.is_empty());
    // One second at 10 m/s east of where GNSS had it: 96.5 km a degree at 30 degrees north.
    let east_m = (prior.pose.unwrap().longitude_deg - START.lon_deg) * 96_486.0;
    assert!((east_m - 10.0).abs() < 0.01, "{east_m}");
    assert!(prior.sigma_position_m > 2.0 && prior.sigma_yaw_rad > 0.02 - 1e-12);
}

#[test]
fn what_is_missing_is_said() {
    let vehicle = Vehicle::new(VehicleConfig::default(), vec![]);
    assert_eq!(vehicle.question(), Err(NotReady::NoOdometry));
    assert_eq!(driven(10.0, 2).question(), Err(NotReady::NoPrior));
    assert!(matches!(driven(0.3, 2).question(), Err(NotReady::TooSlow { .. })));
    let mut blind = Vehicle::new(VehicleConfig::default(), vec![]);
    blind.push_odometry(T0, Pose2::IDENTITY).unwrap();
    blind.push_odometry(T0 + 100_000, Pose2::new(1.0, 0.0, 0.0)).unwrap();
    assert_eq!(blind.question(), Err(NotReady::NoDetections));
}

#[test]
fn a_vehicle_that_stops_long_enough_is_too_slow() {
    let mut vehicle = driven(10.0, 5);
    for i in 51..110 {
        vehicle.push_odometry(T0 + i * 100_000, Pose2::new(50.0, 0.0, 0.0)).unwrap();
    }
    assert!(matches!(vehicle.question(), Err(NotReady::TooSlow { .. })));
}

#[test]
fn a_fix_is_carried_to_now_and_becomes_the_next_prior() {
    let mut vehicle = driven(10.0, 6);
    vehicle.push_pose(gnss(T0 + 6_000_000, 5.0, 0.1)).unwrap();
    let question = vehicle.question().unwrap();
    drive(&mut vehicle, 10.0, 61, 70);
    let mut answer = usable_answer(question.time_us());
    answer.pose.as_mut().unwrap().latitude_deg = 30.001;
    let fix = vehicle.accept(&question, &answer).unwrap();
    assert!((fix.age_s - 1.0).abs() < 1e-9);
    let position = vehicle.position().unwrap();
    assert!((position.pose.at.lat_deg - 30.001).abs() < 1e-7);
    let east_m = (position.pose.at.lon_deg - START.lon_deg) * 96_485.0;
    assert!((east_m - 10.0).abs() < 0.01, "{east_m}");
    assert!(position.pose.sigma_position_m > fix.pose.sigma_position_m);
    assert!((position.fix_age_s.unwrap() - 1.0).abs() < 1e-9);
    let prior = vehicle.question().unwrap().request.prior.unwrap();
    assert!((prior.pose.unwrap().latitude_deg - 30.001).abs() < 1e-7);
    assert!(prior.sigma_position_m >= VehicleConfig::default().min_prior_sigma_position_m);
}

#[test]
fn a_rejected_answer_changes_nothing() {
    let mut vehicle = driven(10.0, 6);
    vehicle.push_pose(gnss(T0 + 6_000_000, 5.0, 0.1)).unwrap();
    let before = vehicle.position();
    let question = vehicle.question().unwrap();
    let answer =
        v1::LocalizeResponse { status: v1::FixStatus::Ambiguous as i32, ..usable_answer(question.time_us()) };
    assert!(matches!(vehicle.accept(&question, &answer), Err(Rejection::Status { .. })));
    assert_eq!(vehicle.position(), before);
}

#[test]
fn an_answer_that_was_overtaken_is_not_used() {
    let mut vehicle = driven(10.0, 6);
    vehicle.push_pose(gnss(T0 + 6_000_000, 5.0, 0.1)).unwrap();
    let older = vehicle.question().unwrap();
    drive(&mut vehicle, 10.0, 61, 65);
    let newer = vehicle.question().unwrap();
    vehicle.accept(&newer, &usable_answer(newer.time_us())).unwrap();
    let answer = usable_answer(older.time_us());
    assert_eq!(vehicle.accept(&older, &answer), Err(Rejection::Superseded));
}

#[test]
fn poses_from_outside_help_where_they_are_better_and_wait_for_odometry() {
    let mut vehicle = driven(10.0, 6);
    vehicle.push_pose(gnss(T0 + 6_000_000, 0.2, 0.1)).unwrap();
    vehicle.push_pose(gnss(T0 + 6_000_000, 5.0, 0.01)).unwrap();
    let pose = vehicle.position().unwrap().pose;
    assert!((pose.sigma_position_m, pose.sigma_yaw_rad) == (0.2, 0.01), "{pose:?}");
    vehicle.push_pose(gnss(T0 + 6_050_000, 0.1, 0.1)).unwrap();
    assert_eq!(vehicle.position().unwrap().pose, pose, "it is ahead of odometry");
    drive(&mut vehicle, 10.0, 61, 61);
    assert!(vehicle.position().unwrap().pose.sigma_position_m < 0.2);
    vehicle.forget_position();
    assert_eq!(vehicle.position(), None);
}

#[test]
fn poses_that_are_none_are_refused() {
    let mut vehicle = driven(10.0, 6);
    for pose in [
        gnss(T0, f64::NAN, 0.1),
        gnss(T0, 1.0, -0.1),
        GeoPose { yaw_rad: f64::INFINITY, ..gnss(T0, 1.0, 0.1) },
        GeoPose { at: LatLon { lat_deg: 89.0, lon_deg: 0.0 }, ..gnss(T0, 1.0, 0.1) },
    ] {
        assert!(matches!(vehicle.push_pose(pose), Err(Error::NotAPose { .. })), "{pose:?}");
    }
    assert!(matches!(vehicle.push_pose(gnss(T0 - 1, 1.0, 0.1)), Err(Error::TooLate { .. })));
}

/// Catches one scan on odometry's newest pose that is sent with that pose alone: it has no velocity, and the service counts
/// the vehicle as standing.
#[test]
fn one_scan_on_the_newest_odometry_pose_has_a_speed() {
    let config = VehicleConfig { window_s: 0.01, ..VehicleConfig::default() };
    let mut vehicle = Vehicle::new(config, vec![Mount::IDENTITY]);
    drive(&mut vehicle, 10.0, 0, 20);
    vehicle.push_pose(gnss(T0 + 2_000_000, 2.0, 0.02)).unwrap();
    let batch = vehicle.question().unwrap().request.batch.unwrap();
    let (scans, odometry) = (batch.scans.unwrap(), batch.odometry.unwrap());
    assert_eq!((scans.sensor.len(), &odometry.time_offset_us[..]), (1, &[-100_000, 0][..]));
    let way = crate::testing::decode::odometry(&odometry, batch.reference_time_us);
    assert!((way.velocity_at(batch.reference_time_us).unwrap().forward_mps - 10.0).abs() < 1e-9);
}

/// Catches a vehicle that sends slant ranges, or a turn of a spinning radar as if it was taken at once.
#[test]
fn what_is_sent_lies_on_the_ground_at_its_own_time() {
    let mut vehicle = driven(10.0, 6);
    let scan = Scan {
        time_us: T0 + 5_950_000,
        range_m: vec![10.0, 20.0],
        azimuth_rad: vec![0.1, 0.2],
        radial_speed_mps: vec![-9.9 * 0.98, -9.8 * 0.98],
        elevation_rad: vec![0.2, 0.2],
        detection_time_offset_us: vec![-100_000, 25_000],
        ..Scan::default()
    };
    vehicle.push_scan(scan).unwrap();
    vehicle.push_pose(gnss(T0 + 6_000_000, 2.0, 0.02)).unwrap();
    let scans = vehicle.question().unwrap().request.batch.unwrap().scans.unwrap();
    assert!(scans.elevation_rad.is_empty() && scans.detection_time_offset_us.is_empty());
    let at = |offset_us: i64| {
        let scans = crate::testing::decode::scans(&scans, 0);
        scans.into_iter().find(|scan| scan.time_us == offset_us).unwrap().range_m[0]
    };
    assert!(
        (at(-150_000) - 10.0 * 0.2_f32.cos()).abs() < 1e-4
            && (at(-25_000) - 20.0 * 0.2_f32.cos()).abs() < 1e-4
    );
}

/// Drives 6 s between posts whose radial speeds are spoiled.
fn driven_past_posts(spoil: fn(f32) -> f32) -> Vehicle {
    let mut vehicle = Vehicle::new(VehicleConfig::default(), vec![Mount::IDENTITY]);
    for i in 0..=60 {
        let time_us = T0 + i * 100_000;
        vehicle.push_odometry(time_us, Pose2::new(i as f64, 0.0, 0.0)).unwrap();
        let azimuth_rad: Vec<f32> = (0..20).map(|post| 0.1 * post as f32 - 1.0).collect();
        let radial_speed_mps = azimuth_rad.iter().map(|a| spoil(-10.0 * a.cos())).collect();
        let scan =
            Scan { time_us, range_m: vec![20.0; 20], azimuth_rad, radial_speed_mps, ..Scan::default() };
        vehicle.push_scan(scan).unwrap();
    }
    vehicle
}

/// Catches a vehicle that asks "are the radars running?" where the sign of their radial speeds is wrong, and requests that
/// do not tell the service.
#[test]
fn radial_speeds_in_another_convention_are_asked_for() {
    assert_eq!(driven_past_posts(|v| v).findings(), []);
    let error = driven_past_posts(|v| -v).question().unwrap_err();
    let question =
        "100 % of the returns were dropped as moving: is the radial speed positive away from the sensor?";
    assert_eq!(error.to_string(), question);
    // Some stands still: the batch is sent, and tells.
    let mut vehicle = driven_past_posts(|v| -v);
    vehicle
        .push_scan(Scan {
            time_us: T0 + 6_000_000,
            range_m: vec![9.0; 3],
            azimuth_rad: vec![0.1; 3],
            ..Scan::default()
        })
        .unwrap();
    vehicle.push_pose(gnss(T0 + 6_000_000, 2.0, 0.02)).unwrap();
    let batch = vehicle.question().unwrap().request.batch.unwrap();
    assert_eq!(batch.suspected, [v1::Convention::RadialSpeedTowards as i32]);
    assert_eq!(batch.dropped.unwrap().moving, 51 * 20);
}

/// Where a vehicle truly is that speeds up, slows down and turns, every 20 ms from [`T0`] on.
fn winding_way(seconds: usize) -> Vec<Pose2> {
    let mut way = vec![Pose2::IDENTITY];
    for step in 0..50 * seconds {
        let t = 0.02 * (step as f64 + 0.5);
        let (speed, turn) = (7.0 + 5.0 * (0.4 * t).sin(), 0.3 * (0.23 * t).sin());
        way.push(way[step].compose(&Pose2::new(0.02 * speed, 0.0, 0.02 * turn)));
    }
    way
}

/// Drives so for three minutes with a radar without radial speeds, whose stamps come 60 ms late. A fix a second is what the
/// service would make of it: where the body was when the newest scan was taken, give or take some centimetres.
fn driven_late(mode: CalibrationUse) -> (Vehicle, Vec<f32>) {
    const LATE_US: i64 = 60_000;
    let way = winding_way(180);
    let at = |time_us: i64| way[usize::try_from((time_us - T0) / 20_000).unwrap()];
    let calibration = VehicleCalibration { mode, ..Default::default() };
    let config = VehicleConfig { calibration, ..VehicleConfig::default() };
    let mut vehicle = Vehicle::new(config, vec![Mount::new(3.5, 0.0, 0.0)]);
    let grid = geo::Grid::of(START).unwrap();
    let start = grid.pose_from_geodetic(START, 0.0).unwrap();
    let scale = grid.scale_factor(START).unwrap();
    let mut declared_s = Vec::new();
    for (step, pose) in (0_i64..).zip(&way) {
        let time_us = T0 + 20_000 * step;
        vehicle.push_odometry(time_us, *pose).unwrap();
        if step % 5 == 0 && step > 5 {
            let scan = Scan { time_us, range_m: vec![9.0; 3], azimuth_rad: vec![0.1; 3], ..Scan::default() };
            vehicle.push_scan(scan).unwrap();
        }
        if step % 50 != 10 || step < 100 {
            continue;
        }
        if vehicle.position().is_none() {
            vehicle.push_pose(gnss(time_us, 2.0, 0.02)).unwrap();
        }
        let question = vehicle.question().unwrap();
        // The newest scan was pushed with this pose.
        let noise_m = 0.05 * ((step * 7919 % 13) as f64 / 6.0 - 1.0);
        let shown = at(time_us - LATE_US).compose(&Pose2::new(noise_m, -noise_m, 0.02 * noise_m));
        let scaled = Pose2::new(scale * shown.x_m, scale * shown.y_m, shown.yaw_rad);
        let (at, yaw_rad) = grid.pose_to_geodetic(&start.compose(&scaled)).unwrap();
        let mut answer = usable_answer(question.time_us());
        answer.pose = Some(v1::GeodeticPose { latitude_deg: at.lat_deg, longitude_deg: at.lon_deg, yaw_rad });
        vehicle.accept(&question, &answer).unwrap();
        let mounts = &question.request.batch.as_ref().unwrap().mounts;
        declared_s.push(mounts[0].sigma_time_s.unwrap());
    }
    (vehicle, declared_s)
}

/// Catches fixes that are not made use of, a correction with the wrong sign or one that is estimated again after it was
/// applied, and an error that is only to be reported and is not declared.
#[test]
fn without_radial_speeds_fixes_show_a_late_clock() {
    let (vehicle, declared_s) = driven_late(CalibrationUse::Apply);
    let radar = vehicle.radars()[0];
    assert!((radar.late_s - 0.06).abs() < 0.01 && radar.sigma.time_s < 0.01, "{radar:?}");
    assert!((radar.mount.x_m - 3.5).abs() < 0.05 && radar.mount.y_m.abs() < 0.05, "{radar:?}");
    assert!(declared_s.iter().all(|sigma| *sigma > 1e-4), "{declared_s:?}");
    let (vehicle, declared_s) = driven_late(CalibrationUse::Report);
    let radar = vehicle.radars()[0];
    assert!(radar.late_s.abs() < 1e-12 && *declared_s.last().unwrap() > 0.04, "{radar:?}");
    let (vehicle, _) = driven_late(CalibrationUse::Off);
    assert_eq!(vehicle.radars()[0].estimate, None);
}
