use std::collections::BTreeSet;

use echofix_core::gate::Gate;
use echofix_core::geo::CellIndex;
use echofix_core::odometry::Trajectory;
use echofix_core::point::MapPoint;
use echofix_core::pose::wrap_angle;

use super::*;
use crate::city::{City, CityParams};
use crate::plane::{Point, add, dot, sub};
use crate::radar::{Clutter, Noise};

fn city() -> City {
    City::generate(&CityParams::default()).unwrap()
}

fn drive(city: &City, day: u32, length_m: f64, params: &DriveParams) -> Drive {
    simulate(&city.on_day(day), &Route::wander(city, 11, length_m), params).unwrap()
}

/// The true trajectory in city metres, recovered from the geodetic truth.
fn truth(city: &City, drive: &Drive) -> Trajectory {
    let grid = Grid::new(city.site().zone()).unwrap();
    let pose = |p: &GeoPose| {
        let pose = grid.pose_from_geodetic(p.at, p.yaw_rad).unwrap();
        let [x_m, y_m] = city.site().from_map(MapPoint::of(&pose));
        (p.time_us, Pose2::new(x_m, y_m, pose.yaw_rad))
    };
    Trajectory::new(drive.truth.iter().map(pose)).unwrap()
}

fn quiet(noise: f64) -> DriveParams {
    let mut params = DriveParams { pose_rate_hz: 100.0, ..DriveParams::default() };
    for radar in &mut params.radars {
        radar.clutter = Clutter { moving: 0.0, at_rest: 0.0 };
        radar.noise = Noise {
            range_m: noise * radar.noise.range_m,
            azimuth_rad: noise * radar.noise.azimuth_rad,
            ..radar.noise
        };
    }
    params
}

#[test]
fn the_same_arguments_give_the_same_drive() {
    let (city, params) = (city(), DriveParams::default());
    let one = drive(&city, 1, 150.0, &params);
    assert_eq!(one, drive(&city, 1, 150.0, &params));
    assert_ne!(one.scans, drive(&city, 2, 150.0, &params).scans);
    assert_ne!(one.scans, drive(&city, 1, 150.0, &DriveParams { seed: 2, ..params }).scans);
}

#[test]
fn one_radar_less_leaves_the_others_as_they_are() {
    let (city, params) = (city(), DriveParams::default());
    let all = drive(&city, 1, 100.0, &params);
    let only = drive(&city, 1, 100.0, &DriveParams { radars: vec![RadarSpec::esr()], ..params });
    let esr: Vec<_> = all.scans.into_iter().filter(|s| s.sensor == 0).collect();
    assert_eq!(esr, only.scans);
}

#[test]
fn scans_are_valid_in_order_and_covered_by_odometry() {
    let city = city();
    let drive = drive(&city, 1, 300.0, &DriveParams::default());
    assert!(drive.scans.is_sorted_by_key(|s| s.time_us));
    for scan in &drive.scans {
        assert_eq!(scan.validate(), Ok(()));
        assert_eq!((scan.radial_speed_mps.len(), scan.rcs_dbsm.len()), (scan.len(), scan.len()));
        assert!(drive.odometry.at(scan.time_us).is_some() && scan.len() <= 64);
    }
    let span_s = 1e-6 * (drive.scans.last().unwrap().time_us - drive.scans[0].time_us) as f64;
    let rate_hz = drive.scans.len() as f64 / span_s / 3.0;
    assert!((rate_hz - 20.0).abs() < 0.1, "{rate_hz}");
}

#[test]
fn detections_stay_in_the_field_of_view() {
    let city = city();
    let params = DriveParams::default();
    for scan in drive(&city, 1, 300.0, &params).scans {
        let spec = &params.radars[scan.sensor];
        for row in 0..scan.len() {
            // Columns are single precision.
            let (range_m, azimuth_rad) = (f64::from(scan.range_m[row]), f64::from(scan.azimuth_rad[row]));
            assert!(spec.sees(range_m - 1e-4, azimuth_rad * (1.0 - 1e-6)), "{range_m} {azimuth_rad}");
        }
    }
}

#[test]
fn doppler_of_the_stationary_world_follows_from_the_true_velocity() {
    let city = City::generate(&CityParams { traffic_per_km: 0.0, ..CityParams::default() }).unwrap();
    let drive = drive(&city, 1, 400.0, &quiet(0.0));
    let truth = truth(&city, &drive);
    let (mut sum, mut count, mut turning) = (0.0, 0.0, 0);
    for scan in &drive.scans {
        let Some(v) = truth.velocity_at(scan.time_us) else { continue };
        let mount = drive.mounts[scan.sensor];
        let sensor =
            [v.forward_mps - v.yaw_rate_radps * mount.y_m, v.left_mps + v.yaw_rate_radps * mount.x_m];
        turning += usize::from(v.yaw_rate_radps.abs() > 0.3);
        for row in 0..scan.len() {
            let (s, c) = (f64::from(scan.azimuth_rad[row]) + mount.yaw_rad).sin_cos();
            let residual = f64::from(scan.radial_speed_mps[row]) + dot(sensor, [c, s]);
            assert!(residual.abs() < 0.7, "{residual}");
            sum += residual * residual;
            count += 1.0;
        }
    }
    assert!(count > 10_000.0 && turning > 20, "{count} {turning}");
    let rms = f64::sqrt(sum / count);
    assert!((rms - 0.1).abs() < 0.01, "{rms}");
}

#[test]
fn traffic_stands_out_by_its_doppler() {
    let city = city();
    let drive = drive(&city, 1, 400.0, &quiet(1.0));
    let truth = truth(&city, &drive);
    let mut moving = 0;
    for scan in &drive.scans {
        let Some(v) = truth.velocity_at(scan.time_us) else { continue };
        for row in 0..scan.len() {
            let angle = f64::from(scan.azimuth_rad[row]) + drive.mounts[scan.sensor].yaw_rad;
            let residual = f64::from(scan.radial_speed_mps[row]) + v.forward_mps * angle.cos();
            moving += usize::from(residual.abs() > 3.0);
        }
    }
    let all: usize = drive.scans.iter().map(Scan::len).sum();
    let fraction = moving as f64 / all as f64;
    assert!((0.01..0.3).contains(&fraction), "{fraction}");
}

#[test]
fn nothing_is_seen_through_a_wall() {
    let city = city();
    let drive = drive(&city, 1, 300.0, &quiet(0.0));
    let truth = truth(&city, &drive);
    for scan in drive.scans.iter().step_by(7) {
        let Some(pose) = truth.at(scan.time_us) else { continue };
        let sensor = pose.compose(&drive.mounts[scan.sensor]);
        let eye: Point = [sensor.x_m, sensor.y_m];
        for row in 0..scan.len() {
            // Traffic at the end of a lane may be anywhere; structure is exact but for the poses' millimetres.
            let short = add(
                eye,
                1.0 - 0.3 / f64::from(scan.range_m[row]),
                sub(sensor.transform(scan.sensor_point(row)), eye),
            );
            assert!(!city.walls().blocks(eye, short));
        }
    }
}

#[test]
fn clutter_is_intense_at_rest() {
    let city = city();
    let drive = drive(&city, 1, 300.0, &DriveParams::default());
    let truth = truth(&city, &drive);
    let weak = |still: bool| {
        let speed = |s: &&Scan| truth.velocity_at(s.time_us).map(|v| v.speed_mps());
        let chosen = |s: &&Scan| speed(s).is_some_and(|v| if still { v < 0.1 } else { v > 4.0 });
        let scans: Vec<_> = drive.scans.iter().filter(chosen).collect();
        let far = |s: &&Scan| s.range_m.iter().filter(|r| **r > 50.0).count();
        scans.iter().map(far).sum::<usize>() as f64 / scans.len() as f64
    };
    assert!(weak(true) > 1.4 * weak(false), "{} {}", weak(true), weak(false));
}

#[test]
fn odometry_measures_ground_metres_from_its_own_start() {
    let city = city();
    let drive =
        drive(&city, 1, 300.0, &DriveParams { odometry: OdometryModel::Perfect, ..DriveParams::default() });
    let truth = truth(&city, &drive);
    assert!(drive.odometry.first().unwrap().1.distance_m(&Pose2::IDENTITY) < 1e-9);
    let start = truth.first().unwrap().1;
    for (time_us, pose) in truth.iter() {
        let expected = start.between(&pose);
        let Some(found) = drive.odometry.at(time_us) else { continue };
        assert!(expected.distance_m(&found) < 5e-3, "{expected:?} {found:?}");
        assert!(wrap_angle(expected.yaw_rad - found.yaw_rad).abs() < 1e-3);
    }
    // The map's metres are shorter by the scale factor, which differs from one here.
    assert!((city.site().scale() - 1.0).abs() > 1e-4);
}

#[test]
fn the_reference_errs_as_its_sigmas_say() {
    let city = city();
    let site = city.site();
    let grid = Grid::new(site.zone()).unwrap();
    let mut squares = [0.0; 2];
    let mut count = 0.0;
    for seed in 0..60 {
        let params = DriveParams { seed, radars: Vec::new(), pose_rate_hz: 0.5, ..DriveParams::default() };
        let drive = drive(&city, 1, 300.0, &params);
        for (believed, true_pose) in drive.reference.iter().zip(&drive.truth) {
            assert!((believed.sigma_position_m - 0.1).abs() < 1e-12 && true_pose.sigma_position_m == 0.0);
            let (b, t) = (grid.project(believed.at).unwrap(), grid.project(true_pose.at).unwrap());
            squares[0] += 0.5 * b.distance_m(t).powi(2);
            squares[1] += wrap_angle(believed.yaw_rad - true_pose.yaw_rad).powi(2);
            count += 1.0;
        }
    }
    let [position_m, yaw_rad] = squares.map(|s| f64::sqrt(s / count));
    assert!((position_m - 0.1).abs() < 0.02, "{position_m}");
    assert!((yaw_rad.to_degrees() - 0.15).abs() < 0.03, "{}", yaw_rad.to_degrees());
}

#[test]
fn a_batch_of_five_seconds_fills_some_thousand_cells() {
    let city = city();
    let drive =
        drive(&city, 1, 900.0, &DriveParams { odometry: OdometryModel::Perfect, ..DriveParams::default() });
    let gate = Gate::default();
    let last_us = drive.scans.last().unwrap().time_us;
    let mut counts = Vec::new();
    for start_us in (drive.scans[0].time_us..last_us - 5_000_000).step_by(5_000_000) {
        let within = |s: &&Scan| (start_us..start_us + 5_000_000).contains(&s.time_us);
        let mut cells = BTreeSet::new();
        let mut slowest_mps = f64::MAX;
        for scan in drive.scans.iter().filter(within) {
            slowest_mps = slowest_mps.min(drive.odometry.velocity_at(scan.time_us).unwrap().speed_mps());
            let sensor = drive.odometry.at(scan.time_us).unwrap().compose(&drive.mounts[scan.sensor]);
            for row in (0..scan.len()).filter(|row| f64::from(scan.range_m[*row]) < gate.max_range_m) {
                cells.insert(CellIndex::of(sensor.transform(scan.sensor_point(row)).into()));
            }
        }
        if slowest_mps > 4.0 {
            counts.push(cells.len());
        }
    }
    assert!(counts.len() >= 5, "{counts:?}");
    assert!(counts.iter().all(|c| (5_000..10_000).contains(c)), "{counts:?}");
}

#[test]
fn a_drive_ends_when_told() {
    let city = city();
    let drive = drive(&city, 1, 900.0, &DriveParams { max_duration_s: 12.0, ..DriveParams::default() });
    assert_eq!(drive.truth.len(), 12 * 20 + 1);
    let bad = DriveParams { pose_rate_hz: f64::NAN, ..DriveParams::default() };
    assert!(matches!(
        simulate(&city.on_day(1), &Route::wander(&city, 1, 50.0), &bad),
        Err(Error::Parameter { name: "pose_rate_hz", .. })
    ));
}
