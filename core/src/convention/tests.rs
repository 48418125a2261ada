//! A town of posts, seen by a front and two corner radars of a car that drives and turns; then in each wrong convention.

use std::f64::consts::FRAC_PI_2;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::doppler::static_radial_speed;
use crate::geo::LatLon;
use crate::scan::Scan;

fn mounts() -> [Mount; 3] {
    [Mount::new(3.6, 0.0, 0.0), Mount::new(3.4, 0.7, 0.8), Mount::new(3.4, -0.7, -0.8)]
}

/// What surrounds the car.
#[derive(Debug, Clone, Copy)]
struct Scene {
    speed_mps: f64,
    /// Share of the returns from cars that drive along, at about the same speed.
    alongside: f64,
    /// Share from cars that are overtaken, or overtake: any speed relative to the road.
    traffic: f64,
    /// Share of returns that are nothing.
    clutter: f64,
}

const STREET: Scene = Scene { speed_mps: 9.0, alongside: 0.05, traffic: 0.1, clutter: 0.15 };

/// Ten seconds of scans and the way, which turns to and fro.
fn drive(scene: Scene, seed: u64) -> (Vec<Scan>, Trajectory) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut pose, mut poses) = (Pose2::IDENTITY, Vec::new());
    for i in 0..=100_i64 {
        poses.push((i * 100_000, pose));
        let turn = 0.03 * (i as f64 * 0.1).sin();
        pose = pose.compose(&Pose2::new(0.1 * scene.speed_mps, 0.05 * scene.speed_mps * turn, turn));
    }
    let way = Trajectory::new(poses).unwrap();
    let mut scans = Vec::new();
    for time_us in (0..100).map(|i| i * 100_000 + 50_000) {
        let v = way.velocity_at(time_us).unwrap();
        for (sensor, mount) in mounts().iter().enumerate() {
            let mut scan = Scan { sensor, time_us, ..Scan::default() };
            for _ in 0..20 {
                let azimuth = rng.random_range(-1.2..1.2_f64);
                let still = static_radial_speed(mount, v, azimuth);
                let kind: f64 = rng.random();
                let radial_speed = if kind < scene.alongside {
                    rng.random_range(-0.3..0.3)
                } else if kind < scene.alongside + scene.traffic {
                    still + rng.random_range(-12.0..12.0) * azimuth.cos()
                } else if kind < scene.alongside + scene.traffic + scene.clutter {
                    rng.random_range(-20.0..20.0)
                } else {
                    still + rng.random_range(-0.15..0.15)
                };
                scan.range_m.push(rng.random_range(3.0..49.0));
                scan.azimuth_rad.push(azimuth as f32);
                scan.radial_speed_mps.push(radial_speed as f32);
            }
            scans.push(scan);
        }
    }
    (scans, way)
}

fn findings_of(scans: &[Scan], way: &Trajectory) -> Vec<Finding> {
    inspect(scans, &mounts(), way).findings()
}

type Spoil = fn(&mut Scan, f32);

/// Each radar convention of the contract, broken; the number is the speed.
const RADAR: [(&str, Spoil, &[Convention]); 7] = [
    ("towards", |s, _| each(&mut s.radial_speed_mps, |v| -v), &[Convention::RadialSpeedTowards]),
    ("km/h", |s, _| each(&mut s.radial_speed_mps, |v| 3.6 * v), &[Convention::RadialSpeedKmh]),
    ("clockwise", |s, _| each(&mut s.azimuth_rad, |a| -a), &[Convention::AzimuthClockwise]),
    ("degrees", |s, _| each(&mut s.azimuth_rad, f32::to_degrees), &[Convention::AzimuthDegrees]),
    (
        "towards in km/h",
        |s, _| each(&mut s.radial_speed_mps, |v| -3.6 * v),
        &[Convention::RadialSpeedTowards, Convention::RadialSpeedKmh],
    ),
    (
        "towards and clockwise",
        |s, _| {
            each(&mut s.radial_speed_mps, |v| -v);
            each(&mut s.azimuth_rad, |a| -a);
        },
        &[Convention::RadialSpeedTowards, Convention::AzimuthClockwise],
    ),
    (
        "compensated",
        |s, speed| {
            let mount = mounts()[s.sensor];
            for (v, a) in s.radial_speed_mps.iter_mut().zip(&s.azimuth_rad) {
                *v += speed * (*a + mount.yaw_rad as f32).cos();
            }
        },
        &[Convention::RadialSpeedCompensated],
    ),
];

fn each(column: &mut [f32], change: impl Fn(f32) -> f32) {
    for value in column {
        *value = change(*value);
    }
}

/// Catches a convention that is not recognised, taken for another one, or told without words; from crawling to fast.
#[test]
fn each_wrong_convention_of_a_radar_is_named() {
    for (name, spoil, expected) in RADAR {
        for speed_mps in [4.0, 9.0, 25.0] {
            let (mut scans, way) = drive(Scene { speed_mps, ..STREET }, 1);
            for scan in &mut scans {
                spoil(scan, speed_mps as f32);
            }
            let findings = findings_of(&scans, &way);
            assert_eq!(findings.len(), 1, "{name} at {speed_mps}: {findings:?}");
            assert_eq!(findings[0].suspects(), expected, "{name} at {speed_mps}: {}", findings[0]);
            let text = findings[0].to_string();
            assert!(expected.iter().all(|convention| text.contains(convention.question())), "{text}");
        }
    }
}

/// Catches an inspection that looks at all radars as one, where one of three is wrong.
#[test]
fn one_wrong_radar_of_three_is_named() {
    for (name, spoil, expected) in RADAR {
        let (mut scans, way) = drive(STREET, 2);
        scans.iter_mut().filter(|scan| scan.sensor == 1).for_each(|scan| spoil(scan, 9.0));
        let findings = findings_of(&scans, &way);
        assert_eq!(findings[0].suspects(), expected, "{name}: {findings:?}");
        let text = findings[0].to_string();
        assert!(text.contains("of sensor 1") || text.contains("full turn"), "{text}");
    }
}

/// Catches a false alarm: nothing is suspected of what is right, in traffic of any density, in a jam that overtakes or
/// is overtaken, between lorries that drive along, at a standstill, and without radial speeds.
#[test]
fn what_is_right_is_not_suspected() {
    let scenes = [
        STREET,
        Scene { speed_mps: 0.0, ..STREET },
        Scene { speed_mps: 1.5, traffic: 0.6, ..STREET },
        Scene { speed_mps: 3.0, traffic: 0.7, alongside: 0.1, clutter: 0.1 },
        Scene { speed_mps: 12.0, traffic: 0.7, alongside: 0.1, clutter: 0.1 },
        Scene { speed_mps: 25.0, traffic: 0.1, alongside: 0.7, clutter: 0.05 },
        Scene { speed_mps: 8.0, traffic: 0.0, alongside: 0.8, clutter: 0.05 },
        Scene { speed_mps: 9.0, traffic: 0.0, alongside: 0.0, clutter: 0.9 },
    ];
    for scene in scenes {
        for seed in 0..5 {
            let (mut scans, way) = drive(scene, seed);
            for finding in findings_of(&scans, &way) {
                assert!(finding.suspects().is_empty(), "{scene:?}: {finding}");
            }
            for scan in &mut scans {
                scan.radial_speed_mps.clear();
            }
            assert_eq!(findings_of(&scans, &way), []);
        }
    }
    assert_eq!(Inspection::default().findings(), []);
}

/// Catches an inspection that ignores elevations: what stands still high up would move.
#[test]
fn elevations_are_reckoned_with() {
    let (mut scans, way) = drive(STREET, 4);
    for scan in &mut scans {
        scan.elevation_rad = vec![0.7; scan.len()];
        each(&mut scan.radial_speed_mps, |v| v * 0.7_f32.cos());
    }
    assert_eq!(findings_of(&scans, &way), []);
}

/// Reference poses of a drive that begins in a direction and keeps turning a little, 10 m/s.
fn poses(begin_deg: f64, standing: bool) -> Vec<GeoPose> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let at = LatLon { lat_deg: 48.1, lon_deg: 11.6 };
    let (mut north, mut east) = (0.0, 0.0);
    (0..200)
        .map(|i| {
            let yaw_rad = begin_deg.to_radians() + 0.3 * (f64::from(i) * 0.03).sin();
            if !standing {
                (east, north) = (east + 0.5 * yaw_rad.cos(), north + 0.5 * yaw_rad.sin());
            }
            let jitter = || rng.random_range(-0.15..0.15_f64);
            let [e, n] = [0; 2].map({
                let mut jitter = jitter;
                move |_: i32| jitter()
            });
            let at = LatLon {
                lat_deg: at.lat_deg + (north + n) / 111_195.0,
                lon_deg: at.lon_deg + (east + e) / (111_320.0 * at.lat_deg.to_radians().cos()),
            };
            GeoPose {
                time_us: i64::from(i) * 50_000,
                at,
                yaw_rad,
                sigma_position_m: 0.15,
                sigma_yaw_rad: 0.01,
            }
        })
        .collect()
}

fn sideways(poses: &[GeoPose], odometry: bool) -> Vec<Finding> {
    let mut inspection = Inspection::default();
    for (i, pose) in poses.iter().enumerate() {
        inspection.pass(pose);
        if odometry {
            inspection.roll(pose.time_us, &Pose2::new(0.5 * i as f64, 0.0, 0.0));
        }
    }
    inspection.findings()
}

type SpoilPose = fn(&mut GeoPose);

const YAW: [(SpoilPose, Convention); 4] = [
    (|p| p.yaw_rad = wrap_angle(FRAC_PI_2 - p.yaw_rad), Convention::YawFromNorth),
    (|p| p.yaw_rad = wrap_angle(p.yaw_rad - FRAC_PI_2), Convention::YawFromNorthCounterClockwise),
    (|p| p.yaw_rad = -p.yaw_rad, Convention::YawClockwise),
    (|p| p.at = LatLon { lat_deg: p.at.lon_deg, lon_deg: p.at.lat_deg }, Convention::LatLonSwapped),
];

/// Catches a wrong heading, or exchanged coordinates, that go unnoticed; they are noticed wherever they turn the course by more than
/// 30 degrees.
#[test]
fn a_yaw_in_another_convention_is_named() {
    for (spoil, convention) in YAW {
        let mut noticed = 0;
        for begin_deg in [-170.0, -90.0, -60.0, 0.0, 10.0, 85.0, 110.0, 150.0] {
            let mut poses = poses(begin_deg, false);
            poses.iter_mut().for_each(spoil);
            let findings = sideways(&poses, true);
            noticed += usize::from(!findings.is_empty());
            for finding in findings {
                let suspects = finding.suspects();
                assert!(suspects.contains(&convention), "{convention:?} {begin_deg}: {finding}");
                assert!(finding.to_string().contains(convention.question()), "{finding}");
            }
        }
        assert!(noticed >= 3, "{convention:?}: {noticed}");
    }
    let mut degrees = poses(120.0, false);
    for p in &mut degrees {
        p.yaw_rad = p.yaw_rad.to_degrees();
    }
    assert_eq!(sideways(&degrees, false)[0].suspects(), [Convention::YawDegrees]);
}

/// Catches a false alarm: forwards, backwards, at a standstill with a jittering receiver, and with poses that are hardly
/// known.
#[test]
fn a_yaw_that_is_right_is_not_suspected() {
    for begin_deg in [-170.0, -90.0, 0.0, 45.0, 100.0] {
        let forwards = poses(begin_deg, false);
        assert_eq!(sideways(&forwards, true), []);
        let mut backwards = forwards.clone();
        for p in &mut backwards {
            p.yaw_rad += std::f64::consts::PI;
        }
        assert_eq!(sideways(&backwards, false), []);
        assert_eq!(sideways(&poses(begin_deg, true), false), []);
    }
}

/// Catches a diagnosis without its figures.
#[test]
fn movers_that_outnumber_what_stands_are_told_with_their_share() {
    let (mut scans, way) = drive(STREET, 1);
    for scan in &mut scans {
        each(&mut scan.radial_speed_mps, |v| -v);
    }
    let inspection = inspect(&scans, &mounts(), &way);
    assert_eq!(inspection.mostly_moving(40, 60), None);
    let text = inspection.mostly_moving(59, 41).unwrap().to_string();
    assert_eq!(
        text,
        "59 % of the returns were dropped as moving: is the radial speed positive away from the sensor?"
    );
    let unknown = Inspection::default().mostly_moving(59, 41).unwrap();
    assert!(
        unknown.suspects().is_empty() && unknown.to_string().contains("check signs and units"),
        "{unknown}"
    );
}

/// Catches a believed yaw from north that is told as nothing but wrong, and one that is told although it is right.
#[test]
fn a_prior_from_north_is_recognised_by_the_yaw_that_was_found() {
    let found = 2.8;
    assert_eq!(yaw_suspect(FRAC_PI_2 - found, found), Some(Convention::YawFromNorth));
    assert_eq!(yaw_suspect(found - FRAC_PI_2 + 0.02, found), Some(Convention::YawFromNorthCounterClockwise));
    assert_eq!(yaw_suspect(found.to_degrees(), found), Some(Convention::YawDegrees));
    assert_eq!(yaw_suspect(found + 0.05, found), None);
    assert_eq!(yaw_suspect(found + 0.8, found), None);
}
