//! Self-calibration on simulated drives whose mounts and clocks are off.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use echofix_core::calibration::clock::clock_of_batch;
use echofix_core::calibration::{
    CalibrationConfig, CalibrationSigma, Estimated, RadarCalibration, SelfCalibration,
};
use echofix_core::drive::Drive;
use echofix_core::odometry::Trajectory;
use echofix_core::scan::Mount;
use echofix_sim::{City, CityParams, DriveParams, Route, simulate};

/// By how much a radar's clock and mount are off.
#[derive(Debug, Clone, Copy, Default)]
struct Fault {
    late_s: f64,
    yaw_deg: f64,
    forward_m: f64,
}

/// A drive through a town of its own, with faults of the radars.
fn drive(seed: u64, seconds: f64, faults: [Fault; 3]) -> Drive {
    let city = City::generate(&CityParams { seed, ..CityParams::default() }).unwrap();
    let params = DriveParams { seed, max_duration_s: seconds, ..DriveParams::default() };
    let route = Route::wander(&city, seed, 12.0 * seconds);
    let mut drive = simulate(&city.on_day(0), &route, &params).unwrap();
    for scan in &mut drive.scans {
        scan.time_us += (1e6 * faults[scan.sensor].late_s) as i64;
    }
    for (mount, fault) in drive.mounts.iter_mut().zip(faults) {
        let yaw_rad = mount.yaw_rad - fault.yaw_deg.to_radians();
        *mount = Mount::new(mount.x_m - fault.forward_m, mount.y_m, yaw_rad);
    }
    drive
}

fn calibrated(drive: &Drive, config: CalibrationConfig) -> [RadarCalibration; 3] {
    let mut calibration = SelfCalibration::new(config, &drive.mounts);
    for scan in &drive.scans {
        calibration.add(scan, &drive.odometry);
    }
    [0, 1, 2].map(|sensor| calibration.radar(sensor).unwrap())
}

/// The error of (clock, yaw, forward, left), each with the sigma that it claims.
fn errors(found: &RadarCalibration, fault: &Fault) -> [Estimated; 4] {
    let off = |found: Estimated, truth: f64| Estimated { value: found.value - truth, ..found };
    [
        off(found.late_s, fault.late_s),
        off(found.yaw_rad, fault.yaw_deg.to_radians()),
        off(found.forward_m, fault.forward_m),
        off(found.left_m, 0.0),
    ]
}

fn faults() -> Vec<[Fault; 3]> {
    let none = Fault::default();
    let late = |late_s| Fault { late_s, ..none };
    vec![
        [none; 3],
        [late(0.02); 3],
        [late(0.05); 3],
        [late(0.1); 3],
        [late(0.05), none, none],
        [Fault { yaw_deg: 1.0, ..none }; 3],
        [Fault { yaw_deg: 2.0, ..none }, none, none],
        [none, Fault { yaw_deg: -2.0, ..none }, none],
        [Fault { forward_m: 0.1, ..none }; 3],
        [Fault { late_s: 0.05, yaw_deg: 1.0, ..none }, late(0.1), none],
    ]
}

/// Catches: a wrong sign, a fault of one radar that leaks into another, a bias that more driving does not cure.
#[test]
fn five_minutes_of_town_show_clock_and_mount() {
    for (seed, faults) in (1..).zip(faults()) {
        let found = calibrated(&drive(seed, 300.0, faults), CalibrationConfig::default());
        for (found, fault) in found.iter().zip(&faults) {
            let [late, yaw, forward, left] = errors(found, fault);
            println!(
                "{seed} {fault:?}: late {:.2} +- {:.2} ms, yaw {:.3} +- {:.3} deg, forward {:.3} +- {:.3}, left {:.3} +- {:.3} m",
                1e3 * late.value,
                1e3 * late.sigma,
                yaw.value.to_degrees(),
                yaw.sigma.to_degrees(),
                forward.value,
                forward.sigma,
                left.value,
                left.sigma
            );
            assert!(late.value.abs() < 0.005 && late.sigma < 0.005, "seed {seed}, {fault:?}: clock {late:?}");
            assert!(yaw.value.abs() < 0.1_f64.to_radians(), "seed {seed}, {fault:?}: yaw {yaw:?}");
            assert!(!forward.is_beyond(4.0) && !left.is_beyond(4.0), "{fault:?}: {forward:?} {left:?}");
        }
    }
}

/// Catches: a sigma that counts detections of one scan as independent. Without the floors, which are for what a
/// simulation does not have; the clock's error is compared with its floor, for half a millisecond stays.
#[test]
fn errors_are_as_large_as_their_sigmas_say() {
    let floors = CalibrationSigma { late_s: 1e-3, ..CalibrationSigma::default() };
    let config = CalibrationConfig { floors, lever_scale: 0.0, ..CalibrationConfig::default() };
    // The shorter the drive, the less its few stretches are believed.
    for (seconds, least) in [(30.0, 0.1), (200.0, 0.15)] {
        let mut sums = [0.0; 4];
        let mut most = [0.0_f64; 4];
        let seeds = 12;
        for seed in 21..21 + seeds {
            let faults = [Fault { late_s: 0.03, yaw_deg: 0.5, forward_m: 0.05 }; 3];
            for (found, fault) in calibrated(&drive(seed, seconds, faults), config).iter().zip(&faults) {
                for (i, error) in errors(found, fault).iter().enumerate() {
                    let nees = (error.value / error.sigma).powi(2);
                    sums[i] += nees / (3 * seeds) as f64;
                    most[i] = most[i].max(nees);
                }
            }
        }
        println!("{seconds} s: NEES {sums:?}, most {most:?}");
        for nees in sums {
            assert!((least..2.0).contains(&nees), "{seconds} s: {sums:?}");
        }
    }
}

/// What batches of five seconds say of the clock: how many there are, how many call it off, and the errors of these.
fn batches(seeds: std::ops::Range<u64>, late_s: f64) -> (usize, usize, Vec<f64>) {
    let (mut asked, mut errors) = (0, Vec::new());
    for seed in seeds {
        let drive = drive(seed, 150.0, [Fault { late_s, ..Fault::default() }; 3]);
        let start_us = drive.scans[0].time_us;
        for first in (0..28).map(|k| start_us + 5_000_000 * k) {
            let range = first..first + 5_000_000;
            let scans: Vec<_> = drive.scans.iter().filter(|scan| range.contains(&scan.time_us)).collect();
            let poses = drive.odometry.iter().filter(|(t, _)| range.contains(t));
            let odometry = Trajectory::new(poses).unwrap();
            if odometry.travelled_m() < 10.0 {
                continue;
            }
            asked += 1;
            let clock = clock_of_batch(scans, &drive.mounts, &odometry);
            errors.extend(clock.map(|clock| clock.value - late_s));
        }
    }
    (asked, errors.len(), errors)
}

/// Catches: a false alarm on a sound clock, and a check that never tells.
#[test]
fn a_batch_that_brakes_or_turns_shows_its_late_clock() {
    let (asked, alarms, errors) = batches(41..49, 0.0);
    println!("sound: {alarms} of {asked} called off, {errors:?}");
    assert!(alarms * 200 <= asked, "{alarms} of {asked} sound batches called off: {errors:?}");
    for (late_s, least) in [(0.05, 0.1), (0.1, 0.5)] {
        let (asked, told, errors) = batches(41..45, late_s);
        let most = errors.iter().fold(0.0_f64, |most, error| most.max(error.abs()));
        println!("late {late_s} s: {told} of {asked} told, most off by {most} s");
        assert!(told as f64 >= least * asked as f64, "{late_s} s: {told} of {asked}");
        assert!(most < 0.05, "{late_s} s: {most}");
    }
}
