//! Radial speeds of a simulated drive, traffic and clutter included.

use echofix_core::doppler::dedrift::{OdometryBias, dedrifted};
use echofix_core::doppler::ego::{EgoConfig, ego_velocity};
use echofix_core::drive::Drive;
use echofix_core::odometry::Trajectory;
use echofix_core::scan::Scan;
use echofix_sim::{Drift, DriveParams, Growth, OdometryModel, Route, simulate};
use echofix_tests::town;

/// A drive whose odometry does not err.
fn drive(seed: u64) -> Drive {
    let city = town::town(seed);
    let params = DriveParams { seed, odometry: OdometryModel::Perfect, ..DriveParams::default() };
    simulate(&city.on_day(1), &Route::wander(&city, seed, 250.0), &params).expect("the drive can be made")
}

#[test]
fn the_own_velocity_is_told_among_traffic_and_clutter() {
    let drive = drive(town::seed());
    let tenth = |scan: &Scan| scan.time_us / 100_000;
    let (mut covered, mut all) = (0, 0);
    for group in drive.scans.chunk_by(|a, b| tenth(a) == tenth(b)) {
        let (from_us, to_us) = (group[0].time_us, group[group.len() - 1].time_us);
        let Some(truth) = drive.odometry.velocity_between(from_us, to_us) else { continue };
        all += 1;
        let Some(found) = ego_velocity(group, &drive.mounts, &EgoConfig::default()) else { continue };
        covered += 1;
        let off_mps = (found.velocity.forward_mps - truth.forward_mps).abs();
        let off_radps = (found.velocity.yaw_rate_radps - truth.yaw_rate_radps).abs();
        assert!(
            off_mps < 0.1 && off_radps < 0.05,
            "{off_mps} m/s, {off_radps} rad/s at {from_us}: {found:?}"
        );
    }
    assert!(covered > all * 9 / 10 && all > 100, "{covered} of {all}");
}

#[test]
fn most_of_the_papers_largest_drift_is_taken_back() {
    let seed = town::seed();
    let drive = drive(seed);
    let drift = Drift::over_5_s(Drift::PAPER_LEVELS[2], Growth::Quadratic);
    let seen = |way: &Trajectory| way.last().unwrap().1.between(&way.first().unwrap().1);
    let (mut before, mut after) = (0.0, 0.0);
    let from_us = drive.odometry.first().unwrap().0;
    for (draw, from_us) in (1..=5).map(|draw| (draw, from_us + 5_000_000 * draw)) {
        let span = from_us..=from_us + 5_000_000;
        let truth = Trajectory::new(drive.odometry.iter().filter(|(t, _)| span.contains(t))).unwrap();
        let way = drift.apply(&truth, seed * 1000 + draw as u64).unwrap();
        let scans = drive.scans.iter().filter(|scan| span.contains(&scan.time_us));
        // Mounts that were calibrated: with unknown ones more of the drift could be theirs.
        let ego = EgoConfig { mount_yaw_rad: 0.05_f64.to_radians(), ..EgoConfig::default() };
        let bias = OdometryBias::paper();
        let corrected =
            dedrifted(scans, &drive.mounts, &way, &ego, &bias).expect("the radars tell velocities");
        before += seen(&way).distance_m(&seen(&truth)).powi(2);
        after += seen(&corrected.trajectory).distance_m(&seen(&truth)).powi(2);
    }
    assert!(after < 0.25 * before, "squares of {before} m2 became {after} m2");
}
