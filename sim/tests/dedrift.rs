//! Odometry that radial speeds corrected, on drives of many radars: is it better than before, and as good as it says?

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use echofix_core::doppler::dedrift::{Dedrifted, OdometryBias, dedrifted};
use echofix_core::doppler::ego::EgoConfig;
use echofix_core::drive::Drive;
use echofix_core::gate::{Gate, gate_scan};
use echofix_core::geo::Grid;
use echofix_core::odometry::Trajectory;
use echofix_core::scan::Scan;
use echofix_sim::Family;

/// The true way in ground metres.
fn truth(drive: &Drive) -> Trajectory {
    let first = drive.truth[0].at;
    let grid = Grid::of(first).unwrap();
    let scale = grid.scale_factor(first).unwrap();
    let poses = drive.truth.iter().map(|pose| {
        let mut on_grid = grid.pose_from_geodetic(pose.at, pose.yaw_rad).unwrap();
        (on_grid.x_m, on_grid.y_m) = (on_grid.x_m / scale, on_grid.y_m / scale);
        (pose.time_us, on_grid)
    });
    Trajectory::new(poses).unwrap()
}

/// The gated scans between two times, and the odometry they are organised by.
fn batch(drive: &Drive, from_us: i64, to_us: i64) -> Option<(Vec<Scan>, Trajectory)> {
    let within = |scan: &&Scan| scan.time_us > from_us && scan.time_us <= to_us;
    let mut scans: Vec<Scan> = drive.scans.iter().filter(within).cloned().collect();
    let mut odometry = drive.odometry.clone();
    odometry.trim_before(scans.first()?.time_us);
    odometry.trim_after(scans.last()?.time_us);
    for scan in &mut scans {
        let mount = &drive.mounts[scan.sensor];
        gate_scan(scan, mount, odometry.velocity_at(scan.time_us), &Gate::default());
    }
    scans.retain(|scan| !scan.is_empty());
    (odometry.travelled_m() > 0.375 * 8.0 * (to_us - from_us) as f64 * 1e-6).then_some((scans, odometry))
}

/// The mean error of (forward m/s, left m/s, yaw rate rad/s) over a way.
fn error(way: &Trajectory, truth: &Trajectory) -> [f64; 3] {
    let poses: Vec<_> = way.iter().collect();
    let (mut sum, mut seconds) = ([0.0; 3], 0.0);
    for pair in poses.windows(2) {
        let (Some(from), Some(to)) = (truth.at(pair[0].0), truth.at(pair[1].0)) else { continue };
        let (is, was) = (pair[0].1.between(&pair[1].1), from.between(&to));
        for (sum, off) in sum.iter_mut().zip([is.x_m - was.x_m, is.y_m - was.y_m, is.yaw_rad - was.yaw_rad]) {
            *sum += off;
        }
        seconds += (pair[1].0 - pair[0].0) as f64 * 1e-6;
    }
    sum.map(|sum| sum / seconds)
}

/// What came of a family's batches.
#[derive(Default)]
struct Outcome {
    batches: f64,
    disagreeing: f64,
    /// Squared errors before and after, and in sigmas: by forward, left, yaw rate.
    before: [f64; 3],
    after: [f64; 3],
    nees: [f64; 3],
}

impl Outcome {
    fn add(&mut self, found: &Dedrifted, odometry: &Trajectory, truth: &Trajectory) {
        self.batches += 1.0;
        if !found.agrees {
            self.disagreeing += 1.0;
            return;
        }
        let (before, after) = (error(odometry, truth), error(&found.trajectory, truth));
        for axis in 0..3 {
            self.before[axis] += before[axis].powi(2);
            self.after[axis] += after[axis].powi(2);
            self.nees[axis] += after[axis].powi(2) / found.covariance[(axis, axis)];
        }
    }

    fn of(family: Family, seeds: std::ops::Range<u64>, length_us: i64) -> Self {
        let mut outcome = Self::default();
        for seed in seeds {
            let drive = family.world(seed).unwrap().asking().unwrap();
            let truth = truth(&drive);
            let (first_us, last_us) = (drive.scans[0].time_us, drive.scans.last().unwrap().time_us);
            for from_us in (first_us..last_us - length_us).step_by(length_us.max(4_000_000) as usize) {
                let Some((scans, odometry)) = batch(&drive, from_us, from_us + length_us) else { continue };
                let (ego, bias) = (EgoConfig::default(), OdometryBias::default());
                let found = dedrifted(&scans, &drive.mounts, &odometry, &ego, &bias);
                outcome.add(&found.expect("there are radial speeds"), &odometry, &truth);
            }
        }
        outcome
    }
}

/// Catches a radar with a thousand detections whose own gains take a scale of the wheels, and odometry's noise that is
/// counted as theirs: of 8 s the correction then took nothing off the speed and made the body slide sideways, and of 1 s
/// every fifth was refused.
#[test]
fn many_detections_make_odometry_better_and_not_overconfident() {
    for family in [Family::Imaging, Family::Dense, Family::AnyRadar] {
        for length_us in [1_000_000, 8_000_000] {
            let Outcome { batches, disagreeing, before, after, nees } =
                Outcome::of(family, 31..34, length_us);
            let rms = |sum: [f64; 3]| sum.map(|sum| (sum / batches).sqrt());
            let nees = nees.map(|sum| sum / batches);
            println!(
                "{} {length_us} us: {disagreeing} of {batches} disagree, {:.4?} to {:.4?}, NEES {nees:.2?}",
                family.word(),
                rms(before),
                rms(after)
            );
            assert!(batches >= 15.0 && disagreeing <= 0.02 * batches, "{disagreeing} of {batches}");
            assert!(after[0] < 0.36 * before[0], "{:?} to {:?} m/s", rms(before), rms(after));
            assert!(nees.iter().all(|nees| *nees < 1.0), "{nees:?}");
        }
    }
}
