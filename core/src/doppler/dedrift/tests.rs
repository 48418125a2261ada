use super::*;
use crate::doppler::static_radial_speed;
use crate::pose::Pose2;
use crate::scan::Scan;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

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

/// The velocity around a corner: it brakes, turns and speeds up again within 8 s.
fn around_a_corner(time_us: i64) -> BodyVelocity {
    let phase = (time_us as f64 * 1e-6 / 8.0 * std::f64::consts::TAU).cos();
    BodyVelocity { forward_mps: 5.5 + 1.1 * phase, left_mps: 0.0, yaw_rate_radps: -0.25 * (1.0 - phase) }
}

/// Odometry of it over some seconds, a pose every 20 ms: its steps are off by a scale, and by noise along each axis.
fn corner(seconds: i64, scale: f64, noise_m: f64, seed: u64) -> Trajectory {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut noise = || noise_m * 3_f64.sqrt() * rng.random_range(-1.0..1.0);
    let mut pose = Pose2::IDENTITY;
    let mut way = vec![(0, pose)];
    for step in 0..50 * seconds {
        let v = around_a_corner(20_000 * step + 10_000);
        let (ahead_m, turned) = (0.02 * v.forward_mps * (1.0 + scale), 0.02 * v.yaw_rate_radps);
        let (s, c) = (0.5 * turned).sin_cos();
        pose = pose.compose(&Pose2::new(c * ahead_m + noise(), s * ahead_m + noise(), turned));
        way.push((20_000 * (step + 1), pose));
    }
    Trajectory::new(way).unwrap()
}

/// What one radar at the nose sees around the corner, so many detections a scan, each with an error of so much.
fn seen_around_a_corner(seconds: i64, detections: usize, sigma_mps: f64, seed: u64) -> Vec<Scan> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let scan = |number: i64| {
        let time_us = 80_000 * number + 40_000;
        let azimuth_rad: Vec<f32> = (0..detections).map(|_| rng.random_range(-1.0..1.0_f32)).collect();
        let mut radial = |azimuth: &f32| {
            let exact = static_radial_speed(&mounts()[0], around_a_corner(time_us), f64::from(*azimuth));
            (exact + sigma_mps * 3_f64.sqrt() * rng.random_range(-1.0..1.0)) as f32
        };
        let radial_speed_mps = azimuth_rad.iter().map(&mut radial).collect();
        Scan { time_us, range_m: vec![20.0; detections], azimuth_rad, radial_speed_mps, ..Scan::default() }
    };
    (0..seconds * 1_000_000 / 80_000).map(scan).collect()
}

/// Catches a scale of the wheels that is taken for a gain of the radar, for only that grows with the speed, and for what then
/// does not fit in the bend a turned mount and a body that slides.
#[test]
fn a_scale_of_the_wheels_is_none_of_the_radars() {
    let odometry = corner(8, 0.01, 0.0, 0);
    let scans = seen_around_a_corner(8, 300, 0.1, 1);
    let found = dedrifted(&scans, &mounts()[..1], &odometry, &EgoConfig::default(), &OdometryBias::default())
        .unwrap();
    let BodyVelocity { forward_mps, left_mps, .. } = found.correction;
    let without = OdometryBias { scale: 1e-9, ..OdometryBias::default() };
    let blind = dedrifted(&scans, &mounts()[..1], &odometry, &EgoConfig::default(), &without).unwrap();
    println!("{:?}, sigmas {:?}", found.correction, found.covariance.diagonal().map(f64::sqrt));
    println!("without {:?}, sigmas {:?}", blind.correction, blind.covariance.diagonal().map(f64::sqrt));
    assert!((forward_mps + 0.055).abs() < 0.02, "{forward_mps} m/s");
    assert!(left_mps.abs() < 0.015, "{left_mps} m/s");
    let (metres, radians) = end_error(&found.trajectory, &corner(8, 0.0, 0.0, 0));
    assert!(metres < 0.3 && radians < 0.5_f64.to_radians(), "{metres} m, {radians} rad");
}

/// Catches estimates of a radar with many detections that are weighed as if only detections erred: the noise of odometry from
/// one estimate to the next lies beyond what they may scatter by, and nothing is corrected.
#[test]
fn noise_of_odometry_counts_where_detections_are_many() {
    let mut nees = [0.0; 2];
    for seed in 0..20 {
        let odometry = corner(2, 0.0, 0.002, seed);
        let scans = seen_around_a_corner(2, 1000, 0.15, seed);
        let (ego, bias) = (EgoConfig::default(), OdometryBias::default());
        let found = dedrifted(&scans, &mounts()[..1], &odometry, &ego, &bias).unwrap();
        assert!(found.agrees, "seed {seed}: {:?}", found.correction);
        let off = [found.correction.forward_mps, found.correction.left_mps];
        for (axis, off) in off.iter().enumerate() {
            nees[axis] += off * off / found.covariance[(axis, axis)] / 20.0;
        }
    }
    assert!(nees.iter().all(|nees| *nees < 1.5), "{nees:?}");
}
