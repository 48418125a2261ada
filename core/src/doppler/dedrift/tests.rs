use super::*;
use crate::doppler::static_radial_speed;
use crate::scan::Scan;
use proptest::prelude::*;

fn mounts() -> [Mount; 3] {
    [Mount::new(3.6, 0.0, 0.0), Mount::new(3.4, 0.7, 0.8), Mount::new(3.4, -0.7, -0.8)]
}

/// On a bend at a speed, 5 s, a pose every 20 ms; speed and yaw rate are off by some fraction and rate.
fn bend(scale: f64, gyro_radps: f64) -> Trajectory {
    let (dt_s, speed_mps, yaw_rate) = (0.02, 8.0 * (1.0 + scale), 0.15 + gyro_radps);
    let radius_m = speed_mps / yaw_rate;
    let pose = |i: i64| {
        let turned = yaw_rate * dt_s * i as f64;
        Pose2::new(radius_m * turned.sin(), radius_m * (1.0 - turned.cos()), turned)
    };
    Trajectory::new((0..=250).map(|i| (i * 20_000, pose(i)))).unwrap()
}

/// What the radars see on the true bend, without error.
fn seen() -> Vec<Scan> {
    let truth = bend(0.0, 0.0);
    let scan = |i: i64| {
        let (sensor, time_us) = (i as usize % 3, 15_000 * i);
        let v = truth.velocity_at(time_us).unwrap();
        let azimuth_rad: Vec<f32> = (-10..=10).map(|k| 0.08 * k as f32).collect();
        let radial = |azimuth: &f32| static_radial_speed(&mounts()[sensor], v, f64::from(*azimuth)) as f32;
        let radial_speed_mps = azimuth_rad.iter().map(radial).collect();
        Scan { sensor, time_us, range_m: vec![20.0; 21], azimuth_rad, radial_speed_mps, ..Scan::default() }
    };
    (0..333).map(scan).collect()
}

fn end_error(a: &Trajectory, b: &Trajectory) -> (f64, f64) {
    let (a, b) = (a.last().unwrap().1, b.last().unwrap().1);
    (a.distance_m(&b), a.between(&b).yaw_rad.abs())
}

proptest! {
    /// Catches a scale that is not found, and a heading that the correction makes worse: what the gyro's bias is, radars
    /// at the nose cannot tell from sliding sideways.
    #[test]
    fn a_scale_is_found_and_a_bias_is_not_made_worse(scale in -0.01..0.01_f64, gyro in -0.006..0.006_f64) {
        let odometry = bend(scale, gyro);
        let found = dedrifted(&seen(), &mounts(), &odometry, &EgoConfig::default(), &OdometryBias::paper()).unwrap();
        prop_assert!(found.agrees && found.estimates >= 45, "{} of {}", found.agrees, found.estimates);
        let off_mps = found.correction.forward_mps + 8.0 * scale;
        prop_assert!(off_mps.abs() < 0.1 * (8.0 * scale).abs() + 0.02, "{off_mps} m/s");
        let (_, radians) = end_error(&found.trajectory, &bend(0.0, 0.0));
        let (_, before_rad) = end_error(&odometry, &bend(0.0, 0.0));
        prop_assert!(radians < before_rad + 1e-3, "{radians} of {before_rad} rad");
    }
}

#[test]
fn without_radial_speeds_nothing_is_corrected() {
    let mut scans = seen();
    for scan in &mut scans {
        scan.radial_speed_mps.clear();
    }
    let config = (EgoConfig::default(), OdometryBias::default());
    assert_eq!(dedrifted(&scans, &mounts(), &bend(0.0, 0.0), &config.0, &config.1), None);
}

/// Catches an estimate that is compared with the odometry of a stop beside it, which takes two metres off the
/// way of a car that waited at a junction.
#[test]
fn a_stop_corrects_nothing() {
    const STOP_US: std::ops::Range<i64> = 700_000..4_000_000;
    let after =
        |time_us: i64| if time_us < STOP_US.start { time_us } else { time_us + STOP_US.end - STOP_US.start };
    let driven = bend(0.0, 0.0);
    let until: Vec<_> = driven.iter().take_while(|(time_us, _)| *time_us <= 1_000_000).collect();
    let (_, at_rest) = until.iter().find(|(time_us, _)| *time_us >= STOP_US.start).copied().unwrap();
    let rests = STOP_US.step_by(20_000).map(|time_us| (time_us, at_rest));
    let mut way: Vec<_> = until.iter().map(|(time_us, pose)| (after(*time_us), *pose)).chain(rests).collect();
    way.sort_by_key(|(time_us, _)| *time_us);
    let odometry = Trajectory::new(way).unwrap();
    // While it stands, its gate lets no scan through.
    let mut scans: Vec<_> = seen().into_iter().filter(|scan| scan.time_us < 850_000).collect();
    for scan in &mut scans {
        scan.time_us = after(scan.time_us);
    }
    let config = (EgoConfig::default(), OdometryBias::default());
    let found = dedrifted(&scans, &mounts(), &odometry, &config.0, &config.1).unwrap();
    let (metres, radians) = end_error(&found.trajectory, &odometry);
    assert!(metres < 0.05 && radians < 1e-3, "{metres} m, {radians} rad");
}

/// Catches scans that are counted as independent: a mount that is turned by half a degree moved exact odometry by 0.07 m/s
/// to the side, which no number of detections averages out.
#[test]
fn what_a_turned_mount_explains_is_hardly_corrected() {
    let turned = mounts().map(|m| Mount::new(m.x_m, m.y_m, m.yaw_rad - 0.5_f64.to_radians()));
    let config = (EgoConfig::default(), OdometryBias::default());
    for (radars, most_mps) in [(1, 0.03), (3, 0.04)] {
        let seen: Vec<_> = seen().into_iter().filter(|scan| scan.sensor < radars).collect();
        let found = dedrifted(&seen, &turned[..radars], &bend(0.0, 0.0), &config.0, &config.1).unwrap();
        let BodyVelocity { left_mps, yaw_rate_radps, .. } = found.correction;
        assert!(left_mps.abs() < most_mps && yaw_rate_radps.abs() < 1e-3, "{:?}", found.correction);
        assert!(left_mps.abs() < 2.0 * found.covariance[(1, 1)].sqrt(), "{radars}: the covariance says so");
    }
}

/// Catches a correction by radars that contradict odometry by more than either may err.
#[test]
fn where_radars_and_odometry_disagree_nothing_is_corrected_and_the_quality_says_so() {
    let odometry = bend(0.15, 0.0);
    let found =
        dedrifted(&seen(), &mounts(), &odometry, &EgoConfig::default(), &OdometryBias::default()).unwrap();
    assert!(!found.agrees && found.trajectory == odometry, "{:?}", found.correction);
    assert!(found.quality.velocity_mps > 0.5, "{:?}", found.quality);
}
