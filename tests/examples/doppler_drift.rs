//! How much of the odometry's drift radial speeds take back:
//! `cargo run --release -p echofix-tests --example doppler_drift`.
//!
//! Batches of 5 s from simulated drives, each with a draw of the paper's drift (its Sec. "Sensitivity to
//! Odometric Drift"); the error is that of the first pose as seen from the last, which is what smears a
//! batch. Root mean squares: as they are, corrected with a prior of a car's odometry, and with one of the
//! paper's largest drift.

#![allow(clippy::print_stdout, reason = "printing is what an example does")]

use echofix_core::doppler::dedrift::{OdometryBias, dedrifted};
use echofix_core::doppler::ego::EgoConfig;
use echofix_core::drive::Drive;
use echofix_core::odometry::Trajectory;
use echofix_core::scan::Scan;
use echofix_sim::{City, CityParams, Drift, DriveParams, Growth, OdometryModel, Route, simulate};

/// Microseconds of a batch.
const BATCH_US: i64 = 5_000_000;
const DRIVES: u64 = 4;

fn main() {
    let drives: Vec<Drive> = (1..=DRIVES).map(perfect).collect();
    println!("{DRIVES} drives of 600 m, towns 1 to {DRIVES}, batches of 5 s, seeds as numbered.\n");
    println!(
        "| drift at 5 s | batches | position, cm | corrected | expecting the paper's | heading, deg | corrected | expecting the paper's |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    compare("none", &drives, &drives, |way, _| way.clone());
    for level in Drift::PAPER_LEVELS {
        for growth in [Growth::Linear, Growth::Quadratic] {
            let drift = Drift::over_5_s(level, growth);
            let name = format!("{:.0} cm, {} deg, {growth:?}", level.0 * 100.0, level.1);
            compare(&name, &drives, &drives, |way, seed| {
                drift.apply(way, seed).expect("the drift is finite")
            });
        }
    }
    let dead: Vec<Drive> = (1..=DRIVES).map(|seed| drive(seed, OdometryModel::default())).collect();
    compare("dead reckoning of a car", &dead, &drives, |way, _| way.clone());
}

fn perfect(seed: u64) -> Drive {
    drive(seed, OdometryModel::Perfect)
}

fn drive(seed: u64, odometry: OdometryModel) -> Drive {
    let params = CityParams { seed, ..CityParams::default() };
    let city = City::generate(&params).expect("the default town can be made");
    let params = DriveParams { seed, odometry, ..DriveParams::default() };
    simulate(&city.on_day(1), &Route::wander(&city, seed, 600.0), &params).expect("the drive can be made")
}

/// A row of the table: `drives` have the odometry that drifts, `truths` the same ways without error.
fn compare(name: &str, drives: &[Drive], truths: &[Drive], drifted: impl Fn(&Trajectory, u64) -> Trajectory) {
    let (mut batches, mut sums) = (0_u32, [[0.0_f64; 2]; 3]);
    for (seed, (drive, truth)) in (1..).zip(drives.iter().zip(truths)) {
        let (first_us, last_us) = ends(&drive.odometry);
        for (index, from_us) in (1..).zip((first_us..last_us - BATCH_US).step_by(BATCH_US as usize)) {
            let way = drifted(&between(&drive.odometry, from_us), seed * 1000 + index);
            let truth = between(&truth.odometry, from_us);
            if truth.travelled_m() < 10.0 {
                continue;
            }
            let corrected = |bias| {
                let found =
                    dedrifted(scans(drive, from_us), &drive.mounts, &way, &EgoConfig::default(), &bias);
                found.map_or_else(|| way.clone(), |found| found.trajectory)
            };
            let ways = [way.clone(), corrected(OdometryBias::default()), corrected(OdometryBias::paper())];
            batches += 1;
            for (sum, way) in sums.iter_mut().zip(ways) {
                let [metres, radians] = smear(&way, &truth);
                sum[0] += metres * metres;
                sum[1] += radians * radians;
            }
        }
    }
    let mean = sums.map(|sum| sum.map(|sum| (sum / f64::from(batches)).sqrt()));
    let [cm, deg] =
        [0, 1].map(|i| mean.map(|mean| if i == 0 { mean[0] * 100.0 } else { mean[1].to_degrees() }));
    println!(
        "| {name} | {batches} | {:.1} | {:.1} | {:.1} | {:.2} | {:.2} | {:.2} |",
        cm[0], cm[1], cm[2], deg[0], deg[1], deg[2]
    );
}

fn ends(way: &Trajectory) -> (i64, i64) {
    let time = |end: Option<(i64, _)>| end.expect("a drive has odometry").0;
    (time(way.first()), time(way.last()))
}

fn between(way: &Trajectory, from_us: i64) -> Trajectory {
    let poses = way.iter().filter(|(t, _)| (from_us..=from_us + BATCH_US).contains(t));
    Trajectory::new(poses).expect("a part of a trajectory is one")
}

fn scans(drive: &Drive, from_us: i64) -> impl Iterator<Item = &Scan> {
    drive.scans.iter().filter(move |scan| (from_us..=from_us + BATCH_US).contains(&scan.time_us))
}

/// Error of the first pose as the last one sees it: metres and radians.
fn smear(way: &Trajectory, truth: &Trajectory) -> [f64; 2] {
    let seen = |way: &Trajectory| Some(way.last()?.1.between(&way.first()?.1));
    let (a, b) = (seen(way).expect("it has poses"), seen(truth).expect("it has poses"));
    [a.distance_m(&b), a.between(&b).yaw_rad]
}
