//! Mounts and clocks while driving: estimated, applied, and declared with what is left.

use std::collections::VecDeque;

use echofix_core::calibration::{CalibrationConfig, Estimated, RadarCalibration, SelfCalibration};
use echofix_core::drive::GeoPose;
use echofix_core::odometry::{BodyVelocity, Trajectory};
use echofix_core::own_error::MountSigma;
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_core::scan::{Mount, Scan};

use super::fixes::{Applied, FixCalibrator};

/// What becomes of the calibration that a vehicle estimates while it drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CalibrationUse {
    /// Nothing is estimated; what is stated is declared.
    Off,
    /// Estimated and reported; mounts and stamps stay, and what they seem to be off is declared as their error.
    Report,
    /// Estimated, and applied as far as the drive says more than what is stated.
    #[default]
    Apply,
}

/// How a vehicle takes its calibration.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VehicleCalibration {
    /// Whether it is estimated and applied.
    pub mode: CalibrationUse,
    /// How well mounts and clocks are known when the drive begins. A vehicle whose clocks nobody has checked should
    /// state some 50 ms.
    pub stated: MountSigma,
    /// How it is estimated.
    pub estimate: CalibrationConfig,
}

/// One radar as it is used now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadarInUse {
    /// Where it sits.
    pub mount: Mount,
    /// Seconds that are taken from the stamps of its scans.
    pub late_s: f64,
    /// How well both are known.
    pub sigma: MountSigma,
    /// What the drive alone says; `None` before any scan said something.
    pub estimate: Option<RadarCalibration>,
}

/// Scans wait until odometry is so far ahead of them: the largest delay, and what the estimate looks ahead.
const AHEAD_US: i64 = 600_000;
/// Odometry that is remembered, microseconds.
const REMEMBERED_US: i64 = 2_000_000;
/// Scans that wait at most: several radars for some seconds, should odometry stop.
const MAX_WAITING: usize = 512;
/// Between two looks at the estimate, microseconds.
const LOOK_US: i64 = 1_000_000;

/// Estimates while driving.
#[derive(Debug, Clone)]
pub(super) struct Calibrator {
    config: VehicleCalibration,
    built: Vec<Mount>,
    estimator: SelfCalibration,
    fixes: FixCalibrator,
    odometry: Trajectory,
    waiting: VecDeque<Scan>,
    looked_us: i64,
    radars: Vec<RadarInUse>,
}

impl Calibrator {
    pub(super) fn new(config: VehicleCalibration, built: Vec<Mount>) -> Self {
        let radar =
            |mount: &Mount| RadarInUse { mount: *mount, late_s: 0.0, sigma: config.stated, estimate: None };
        Self {
            radars: built.iter().map(radar).collect(),
            estimator: SelfCalibration::new(config.estimate, &built),
            fixes: FixCalibrator::new(&config.estimate),
            odometry: Trajectory::default(),
            waiting: VecDeque::new(),
            looked_us: i64::MIN,
            built,
            config,
        }
    }

    /// Takes a scan as it came, movers and all.
    pub(super) fn push_scan(&mut self, scan: &Scan) {
        if self.config.mode == CalibrationUse::Off || scan.radial_speed_mps.is_empty() {
            return;
        }
        if self.waiting.len() == MAX_WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(Scan { rcs_dbsm: Vec::new(), ..scan.clone() });
    }

    /// Takes an odometry pose that the window has taken; true when the radars in use have changed.
    pub(super) fn push_odometry(&mut self, time_us: i64, pose: Pose2) -> bool {
        if self.config.mode == CalibrationUse::Off || self.odometry.push(time_us, pose).is_err() {
            return false;
        }
        while let Some(scan) =
            self.waiting.pop_front_if(|scan| scan.time_us.saturating_add(AHEAD_US) <= time_us)
        {
            self.estimator.add(&scan, &self.odometry);
        }
        self.odometry.trim_before(time_us.saturating_sub(REMEMBERED_US));
        if time_us < self.looked_us.saturating_add(LOOK_US) {
            return false;
        }
        self.looked_us = time_us;
        for (sensor, radar) in self.radars.iter_mut().enumerate() {
            if let Some(estimate) = self.estimator.radar(sensor) {
                *radar = in_use(&self.built[sensor], &estimate, &self.config);
            }
        }
        self.config.mode == CalibrationUse::Apply
    }

    /// What was applied to a batch of scans between two times that was put together now.
    pub(super) fn applied(&self, from_us: i64, to_us: i64) -> Applied {
        let (built, used) = (self.built.first(), self.radars.first());
        let shift =
            |of: fn(&Mount) -> f64| built.zip(used).map_or(0.0, |(built, used)| of(&used.mount) - of(built));
        let late_s = self.fixes.late_over(from_us, to_us);
        Applied { late_s, forward_m: shift(|mount| mount.x_m), left_m: shift(|mount| mount.y_m) }
    }

    /// Takes a fix that may be used, with the body in odometry's frame and its velocity then, and what was applied to its
    /// batch; true when the radars in use have changed. Radial speeds say more of each radar, where there are any.
    pub(super) fn push_fix(&mut self, fix: &GeoPose, body: (Pose2, BodyVelocity), applied: &Applied) -> bool {
        let by_doppler = (0..self.built.len()).any(|sensor| self.estimator.radar(sensor).is_some());
        if self.config.mode == CalibrationUse::Off || by_doppler {
            return false;
        }
        let Some(estimate) = self.fixes.add(fix, body, applied) else { return false };
        for (built, radar) in self.built.iter().zip(&mut self.radars) {
            *radar = in_use(built, &estimate, &self.config);
        }
        let now_us = self.odometry.last().map_or(fix.time_us, |(time_us, _)| time_us);
        self.fixes.apply_late(now_us, self.radars.first().map_or(0.0, |radar| radar.late_s));
        self.config.mode == CalibrationUse::Apply
    }

    /// The radars as they are used now.
    pub(super) fn radars(&self) -> &[RadarInUse] {
        &self.radars
    }
}

/// A radar after what the drive says of it.
fn in_use(built: &Mount, estimate: &RadarCalibration, config: &VehicleCalibration) -> RadarInUse {
    let stated = &config.stated;
    let known = |estimated: Estimated, stated: f64| {
        let known = weighed(estimated, stated);
        match config.mode {
            CalibrationUse::Apply => known,
            // It stays as it was built, and is off by so much.
            CalibrationUse::Off | CalibrationUse::Report => {
                Estimated { value: 0.0, sigma: known.value.hypot(known.sigma) }
            }
        }
    };
    let late_s = known(estimate.late_s, stated.time_s);
    let yaw_rad = known(estimate.yaw_rad, stated.yaw_rad);
    let forward_m = known(estimate.forward_m, stated.position_m);
    let left_m = known(estimate.left_m, stated.position_m);
    RadarInUse {
        mount: Mount::new(
            built.x_m + forward_m.value,
            built.y_m + left_m.value,
            wrap_angle(built.yaw_rad + yaw_rad.value),
        ),
        late_s: late_s.value,
        sigma: MountSigma {
            time_s: late_s.sigma,
            position_m: forward_m.sigma.max(left_m.sigma),
            yaw_rad: yaw_rad.sigma,
        },
        estimate: Some(*estimate),
    }
}

/// What the drive says, weighed with what was stated (none, within its sigma). Where the drive refutes that, it counts
/// for no more than the drive leaves of it: the stated sigma is raised to the one that makes the estimate most likely.
/// So nothing jumps as the estimate firms up, and a sound calibration is not disturbed by a weak one.
fn weighed(estimated: Estimated, stated: f64) -> Estimated {
    let Estimated { value, sigma } = estimated;
    let shown = (value * value - sigma * sigma).max(0.0);
    let stated = shown.max(stated * stated);
    let sum = stated + sigma * sigma;
    if sum <= 0.0 || !sum.is_finite() {
        return Estimated { value: 0.0, sigma: stated.sqrt() };
    }
    Estimated { value: value * stated / sum, sigma: sigma * (stated / sum).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::doppler::static_radial_speed;
    use echofix_core::odometry::BodyVelocity;

    /// Catches: a weak estimate that moves a sound calibration, and one that is refuted and still believed.
    #[test]
    fn what_is_stated_holds_until_the_drive_refutes_it() {
        let weak = weighed(Estimated { value: 0.03, sigma: 0.05 }, 0.005);
        assert!(weak.value.abs() < 1e-3 && (weak.sigma - 0.005).abs() < 1e-4, "{weak:?}");
        let refuted = weighed(Estimated { value: 0.05, sigma: 0.004 }, 0.005);
        assert!((refuted.value - 0.05).abs() < 1e-3 && (refuted.sigma - 0.004).abs() < 1e-4, "{refuted:?}");
        let exact = weighed(Estimated { value: 0.0, sigma: 0.0 }, 0.0);
        assert_eq!(exact, Estimated { value: 0.0, sigma: 0.0 });
    }

    /// Stops, starts and turns for a minute, seen by a radar whose stamps come late and whose mount is turned.
    fn driven(mode: CalibrationUse) -> Calibrator {
        let built = Mount::new(3.5, 0.5, 0.4);
        let truth = Mount::new(3.5, 0.5, 0.4 + 0.02);
        let mut calibrator = Calibrator::new(VehicleCalibration { mode, ..Default::default() }, vec![built]);
        let speed = |t: f64| 8.0 + 5.0 * (0.5 * t).sin();
        let turn = |t: f64| 0.3 * (0.3 * t).sin();
        let mut pose = Pose2::IDENTITY;
        for step in 0..3000_i64 {
            let (time_us, t) = (step * 20_000, step as f64 * 0.02);
            if step % 3 == 0 {
                let velocity = BodyVelocity {
                    forward_mps: speed(t - 0.05),
                    left_mps: 0.0,
                    yaw_rate_radps: turn(t - 0.05),
                };
                let azimuth_rad: Vec<f32> = (-20..=20).map(|i| 0.04 * i as f32).collect();
                let radial_speed_mps = azimuth_rad
                    .iter()
                    .map(|azimuth| static_radial_speed(&truth, velocity, f64::from(*azimuth)) as f32)
                    .collect();
                let range_m = vec![20.0; azimuth_rad.len()];
                calibrator.push_scan(&Scan {
                    time_us,
                    range_m,
                    azimuth_rad,
                    radial_speed_mps,
                    ..Scan::default()
                });
            }
            calibrator.push_odometry(time_us, pose);
            let half = t + 0.01;
            pose = pose.compose(&Pose2::new(0.02 * speed(half), 0.0, 0.02 * turn(half)));
        }
        calibrator
    }

    /// Catches: a correction with the wrong sign, applied where it shall only be reported, or kept from the levels.
    #[test]
    fn a_late_and_turned_radar_is_corrected_or_its_error_is_declared() {
        let applied = driven(CalibrationUse::Apply).radars()[0];
        assert!((applied.late_s - 0.05).abs() < 0.004, "{applied:?}");
        assert!((applied.mount.yaw_rad - 0.42).abs() < 0.002, "{applied:?}");
        assert!(applied.sigma.time_s < 0.005 && applied.sigma.yaw_rad < 0.002, "{applied:?}");
        let reported = driven(CalibrationUse::Report).radars()[0];
        assert_eq!((reported.mount, reported.late_s), (Mount::new(3.5, 0.5, 0.4), 0.0));
        assert!(reported.sigma.time_s > 0.04 && reported.sigma.yaw_rad > 0.015, "{reported:?}");
        assert!(reported.estimate.is_some());
        let off = driven(CalibrationUse::Off).radars()[0];
        assert_eq!((off.sigma, off.estimate), (MountSigma::default(), None));
    }
}
