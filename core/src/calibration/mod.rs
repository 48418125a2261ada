//! Self-calibration: mounts and clocks of the radars, from what they measure while the vehicle drives.
//!
//! A stationary target's radial speed is the radar's own velocity seen in one direction. Odometry says what that
//! velocity should be. What is left between the two, over minutes of turns, stops and starts, shows
//!
//! - a clock that is late: the error is the acceleration (and the change of the turn) times the delay;
//! - a mount that is turned: the error is the speed across the line of sight times the turn;
//! - a radar that sits elsewhere: the error is the yaw rate times the shift.
//!
//! Nuisances are estimated with them: the wheels' scale, and a scale of the radar's azimuths.
//!
//! The body's origin is taken to be where the body does not slide sideways: the rear axle. A turn that *all* mounts
//! share cannot be told from a body that slides; a shift forward of *all* mounts cannot be told from a gyro whose
//! scale is off. [`CalibrationConfig::floors`] holds what that leaves open.
//!
//! - here: [`SelfCalibration`] of a vehicle, and what it says of each radar.
//! - [`clock`]: does one batch show that the clock is off?
//! - [`fixes`]: clock and lever arm from fixes, for radars without radial speeds.
//! - [`motion`]: odometry's velocity and how it changes.
//! - [`solution`]: the numbers that are estimated of one radar.
//! - [`equation`]: one scan's equations on the calibration.
//! - [`evidence`]: their sums by stretches of time, the solution and its covariance.

pub mod clock;
pub mod equation;
pub mod evidence;
pub mod fixes;
pub mod motion;
pub mod solution;

use crate::odometry::Trajectory;
use crate::pose::wrap_angle;
use crate::scan::{Mount, ScanView};
use equation::ScanEquations;
use evidence::Evidence;
use motion::Motion;
use solution::Solution;

/// How mounts and clocks are estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationConfig {
    /// One-sigma error of what the vehicle was built with. Wide: only what the drive leaves open is taken from it.
    pub prior: CalibrationSigma,
    /// Errors that no length of the drive averages out: one sigma.
    pub floors: CalibrationSigma,
    /// Further error of the lever arm, metres a metre of it: the scale of the gyro.
    pub lever_scale: f64,
    /// One-sigma error of a radial speed, what the error of its azimuth does to it included, metres per second.
    pub sigma_mps: f64,
    /// Detections that err alike: so many count as one where a drive is too short to show it by itself.
    pub alike: f64,
    /// Scans taken slower than this say nothing, metres per second.
    pub min_speed_mps: f64,
    /// Errors are alike within stretches of this length, seconds.
    pub stretch_s: f64,
    /// Stretches that are remembered, the newest.
    pub stretches: usize,
}

impl Default for CalibrationConfig {
    fn default() -> Self {
        Self {
            prior: CalibrationSigma { late_s: 0.3, yaw_rad: 5_f64.to_radians(), forward_m: 0.3, left_m: 0.3 },
            floors: CalibrationSigma {
                late_s: 1e-3,
                yaw_rad: 0.03_f64.to_radians(),
                forward_m: 0.01,
                left_m: 0.01,
            },
            lever_scale: 0.01,
            sigma_mps: 0.15,
            alike: 10.0,
            min_speed_mps: 1.0,
            stretch_s: 5.0,
            stretches: 240,
        }
    }
}

/// One-sigma errors of a radar's clock and mount.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CalibrationSigma {
    /// Of the clock against odometry, seconds.
    pub late_s: f64,
    /// Of the boresight, radians.
    pub yaw_rad: f64,
    /// Of the position forward, metres.
    pub forward_m: f64,
    /// Of the position to the left, metres.
    pub left_m: f64,
}

/// A number with its one-sigma error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Estimated {
    /// The number.
    pub value: f64,
    /// Its one-sigma error.
    pub sigma: f64,
}

impl Estimated {
    /// True when the number differs from zero by more than so many sigmas.
    #[must_use]
    pub fn is_beyond(&self, sigmas: f64) -> bool {
        self.value.abs() > sigmas * self.sigma
    }

    /// The mean of several, weighted by their errors, as if these were independent; at least `floor` is left.
    #[must_use]
    pub fn mean(of: impl IntoIterator<Item = Self>, floor: f64) -> Option<Self> {
        let (mut weights, mut sum) = (0.0, 0.0);
        for Self { value, sigma } in of {
            let weight = sigma.max(f64::MIN_POSITIVE.sqrt()).powi(-2);
            weights += weight;
            sum += weight * value;
        }
        (weights > 0.0).then(|| Self { value: sum / weights, sigma: weights.sqrt().recip().max(floor) })
    }
}

/// What a drive says of one radar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadarCalibration {
    /// Its clock: seconds by which the stamps of its scans come after the moment they show, on odometry's clock.
    pub late_s: Estimated,
    /// Turn of the boresight, radians counter-clockwise, on top of the mount's.
    pub yaw_rad: Estimated,
    /// Position forward, metres, on top of the mount's.
    pub forward_m: Estimated,
    /// Position to the left, metres, on top of the mount's.
    pub left_m: Estimated,
    /// Scans it rests on.
    pub scans: usize,
    /// Seconds of driving it rests on, in whole stretches.
    pub driven_s: f64,
}

impl RadarCalibration {
    /// Where the radar sits, corrected.
    #[must_use]
    pub fn mount(&self, built: &Mount) -> Mount {
        Mount::new(
            built.x_m + self.forward_m.value,
            built.y_m + self.left_m.value,
            wrap_angle(built.yaw_rad + self.yaw_rad.value),
        )
    }

    /// The errors that are left.
    #[must_use]
    pub fn sigma(&self) -> CalibrationSigma {
        CalibrationSigma {
            late_s: self.late_s.sigma,
            yaw_rad: self.yaw_rad.sigma,
            forward_m: self.forward_m.sigma,
            left_m: self.left_m.sigma,
        }
    }
}

/// Mounts and clocks of a vehicle's radars, estimated while it drives. Bounded in memory: some 100 kB a radar.
#[derive(Debug, Clone)]
pub struct SelfCalibration {
    config: CalibrationConfig,
    radars: Vec<Radar>,
}

#[derive(Debug, Clone)]
struct Radar {
    built: Mount,
    evidence: Evidence,
    /// Where the next scan's equations are made linear.
    at: Solution,
}

/// Scans between two looks at the solution, to make the next equations linear there.
const SCANS_A_LOOK: usize = 20;

impl SelfCalibration {
    /// Radars as they were built in.
    #[must_use]
    pub fn new(config: CalibrationConfig, mounts: &[Mount]) -> Self {
        let radar = |built: &Mount| Radar {
            built: *built,
            evidence: Evidence::new(&config),
            at: Solution::default(),
        };
        Self { radars: mounts.iter().map(radar).collect(), config }
    }

    /// Takes a scan, movers and all, with odometry around its time: a quarter of a second before the moment it shows
    /// and after it. True when it says something; one without radial speeds, of an unknown radar, outside odometry, at
    /// rest or amid a jump says nothing.
    pub fn add<'a>(&mut self, scan: impl Into<ScanView<'a>>, odometry: &Trajectory) -> bool {
        let scan = scan.into();
        let Some(radar) = self.radars.get_mut(scan.sensor) else { return false };
        if scan.radial_speed_mps.len() != scan.azimuth_rad.len() {
            return false;
        }
        let shown_us = scan.time_us - (radar.at.late_s() * 1e6) as i64;
        let Some(motion) = Motion::around(odometry, shown_us) else { return false };
        if motion.velocity.speed_mps() < self.config.min_speed_mps {
            return false;
        }
        let equations = ScanEquations::of(&scan, &radar.built, &motion, &radar.at, self.config.sigma_mps);
        let Some(equations) = equations else { return false };
        radar.evidence.add(scan.time_us, &equations);
        if radar.evidence.scans().is_multiple_of(SCANS_A_LOOK) {
            radar.at = radar.evidence.solved().clamped(&self.config.prior);
        }
        true
    }

    /// The radars as they were built in.
    pub fn mounts(&self) -> impl Iterator<Item = Mount> + '_ {
        self.radars.iter().map(|radar| radar.built)
    }

    /// What the drive says of a radar; `None` without any scan that says something.
    #[must_use]
    pub fn radar(&self, sensor: usize) -> Option<RadarCalibration> {
        let Radar { built, evidence, .. } = self.radars.get(sensor)?;
        if evidence.scans() == 0 {
            return None;
        }
        let (solution, covariance) = (evidence.solved(), evidence.covariance());
        let CalibrationSigma { late_s, yaw_rad, forward_m, left_m } = self.config.floors;
        let lever_m = self.config.lever_scale * built.x_m.hypot(built.y_m);
        let number = |index: usize, floor: f64| Estimated {
            value: solution.0[index],
            sigma: covariance[(index, index)].max(0.0).sqrt().hypot(floor),
        };
        Some(RadarCalibration {
            late_s: number(0, late_s),
            yaw_rad: number(1, yaw_rad),
            forward_m: number(2, forward_m.hypot(lever_m)),
            left_m: number(3, left_m),
            scans: evidence.scans(),
            driven_s: evidence.driven_s(),
        })
    }
}
