//! The vehicle's side of localizing, without any network: collect, ask, judge, carry on.
//!
//! 1. Feed what the sensors say as it comes: [`Vehicle::push_odometry`], [`Vehicle::push_scan`],
//!    and rough poses (GNSS) with [`Vehicle::push_pose`].
//! 2. [`Vehicle::question`] makes the request of the last seconds, with the pose believed now as
//!    its prior.
//! 3. [`Localizer::ask`](crate::Localizer::ask) sends it.
//! 4. [`Vehicle::accept`] judges the answer; a good one becomes the pose believed.
//! 5. [`Vehicle::position`] is that pose, carried to now by odometry.
//!
//! While it drives, the vehicle calibrates its radars ([`VehicleCalibration`]): by how much their stamps are late and
//! their mounts are off, from radial speeds against odometry. What is stated holds until the drive refutes it; then it is
//! corrected, and each question declares how well mounts and clocks are known, which the answer's levels take in. A late
//! clock shows with the first start or stop, a turned mount within seconds, a shifted one with the turns of some minutes.
//! A turn that all mounts share is told from a body that slides only where its origin is the rear axle. Where no radar
//! measures radial speeds, the fixes show what all radars share: a late clock and a shift, from how the fixes lie beside
//! odometry as speed and turn change. That takes minutes, and of the boresight it says nothing: state its error.
//!
//! The vehicle has no clock: now is the time of the newest odometry pose. Asking does not borrow
//! it, so sensors can be fed while an answer is on its way.

mod anchor;
mod calibrator;
mod config;
mod fixes;
mod verdict;
mod window;

pub use calibrator::{CalibrationUse, RadarInUse, VehicleCalibration};
pub use config::{AlertLimits, DriftModel, VehicleConfig};
pub use verdict::{Fix, Rejection};

use echofix_core::convention::Finding;
use echofix_core::doppler::dedrift::dedrifted;
use echofix_core::doppler::ego::EgoConfig;
use echofix_core::drive::GeoPose;
use echofix_core::gate::Dropped;
use echofix_core::geo;
use echofix_core::odometry::{self, BodyVelocity, OdometryQuality, Trajectory};
use echofix_core::pose::Pose2;
use echofix_core::scan::{self, Mount, Scan};
use echofix_proto::{delta, v1};

use crate::wire;
use anchor::Anchor;
use calibrator::Calibrator;
use fixes::Applied;
use window::ScanWindow;

/// Why a measurement is not taken.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A scan's columns cannot be used.
    #[error(transparent)]
    Scan(#[from] scan::Error),
    /// An odometry pose cannot be used.
    #[error(transparent)]
    Odometry(#[from] odometry::Error),
    /// A scan of a radar the vehicle does not have.
    #[error("a scan names sensor {sensor}, but the vehicle has {mounts}; sensors count from 0")]
    UnknownSensor {
        /// The sensor named.
        sensor: usize,
        /// Sensors there are.
        mounts: usize,
    },
    /// Odometry is missing or far behind.
    #[error("the measurement at {time_us} us is ahead of odometry; feed odometry first, on the same clock")]
    AheadOfOdometry {
        /// The measurement's time.
        time_us: i64,
    },
    /// The window has moved past a measurement.
    #[error("the measurement at {time_us} us came after the window had moved on to {oldest_us} us")]
    TooLate {
        /// The measurement's time.
        time_us: i64,
        /// Where the window begins.
        oldest_us: i64,
    },
    /// A pose that is not finite or not on the globe.
    #[error("the pose at {time_us} us is not one: {reason}")]
    NotAPose {
        /// The pose's time.
        time_us: i64,
        /// What is wrong with it.
        reason: String,
    },
}

impl Error {
    /// The kind of error as one word, the same in every version.
    #[must_use]
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Scan(error) => error.reason(),
            Self::Odometry(error) => error.reason(),
            Self::NotAPose { .. } => "not_finite",
            Self::UnknownSensor { .. } => "unknown_sensor",
            Self::AheadOfOdometry { .. } => "without_odometry",
            Self::TooLate { .. } => "too_late",
        }
    }
}

/// Why there is nothing to ask yet.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NotReady {
    /// Odometry is missing.
    #[error("there is no odometry yet")]
    NoOdometry,
    /// The window holds no detections, and the vehicle stands or creeps.
    #[error("the vehicle drives at {speed_mps} m/s, too slowly to be localized by radar")]
    TooSlow {
        /// Speed over ground, metres per second.
        speed_mps: f64,
    },
    /// The window holds no detections.
    #[error("the window holds no detections; are the radars running?")]
    NoDetections,
    /// All detections of the window were dropped as moving.
    #[error("{0}")]
    AllMoving(Finding),
    /// Nothing is known of where the vehicle is.
    #[error("there is no rough pose to search around; push one, from GNSS or the last trip")]
    NoPrior,
    /// The prior is not on the map.
    #[error(transparent)]
    OffTheMap(#[from] geo::Error),
}

/// A request, and what ties its answer to the vehicle's odometry.
#[derive(Debug, Clone, PartialEq)]
pub struct LocalizationQuestion {
    /// What is sent.
    pub request: v1::LocalizeRequest,
    time_us: i64,
    /// The odometry pose at that time, and the metres travelled until then.
    odometry: (Pose2, f64),
    /// The body's velocity then.
    velocity: Option<BodyVelocity>,
    /// What was corrected of stamps and mounts.
    applied: Applied,
}

impl LocalizationQuestion {
    /// The time asked for, microseconds since the Unix epoch: the newest scan that odometry covers.
    #[must_use]
    pub fn time_us(&self) -> i64 {
        self.time_us
    }
}

/// The pose believed, carried to the newest odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VehiclePosition {
    /// The pose, its sigmas grown by [`DriftModel`].
    pub pose: GeoPose,
    /// Seconds since the pose of the last fix; `None` before the first.
    pub fix_age_s: Option<f64>,
}

/// One vehicle: its window, and where it believes to be.
#[derive(Debug, Clone)]
pub struct Vehicle {
    config: VehicleConfig,
    window: ScanWindow,
    calibrator: Calibrator,
    anchor: Option<Anchor>,
    /// A pose from outside that odometry does not cover yet.
    ahead: Option<GeoPose>,
    last_fix_us: Option<i64>,
}

impl Vehicle {
    /// A vehicle with these radars.
    #[must_use]
    pub fn new(config: VehicleConfig, mounts: Vec<Mount>) -> Self {
        Self {
            config,
            calibrator: Calibrator::new(config.calibration, mounts.clone()),
            window: ScanWindow::new(&config, mounts),
            anchor: None,
            ahead: None,
            last_fix_us: None,
        }
    }

    /// Takes a scan; scans of several radars may come slightly out of order, and may run ahead of
    /// odometry by less than the window.
    ///
    /// # Errors
    /// When the scan is malformed, of an unknown radar, too late or far ahead of odometry.
    pub fn push_scan(&mut self, mut scan: Scan) -> Result<(), Error> {
        let late_s = self.calibrator.radars().get(scan.sensor).map_or(0.0, |radar| radar.late_s);
        let as_it_came = scan.clone();
        scan.time_us = scan.time_us.saturating_sub(window::micros(late_s));
        self.window.push_scan(&scan)?;
        self.calibrator.push_scan(&as_it_came);
        Ok(())
    }

    /// Takes an odometry pose: microseconds since the Unix epoch, and the pose of the body in any
    /// frame that stays the same.
    ///
    /// # Errors
    /// When the time does not increase or the pose is not finite.
    pub fn push_odometry(&mut self, time_us: i64, pose: Pose2) -> Result<(), Error> {
        self.window.push_odometry(time_us, pose)?;
        if self.calibrator.push_odometry(time_us, pose) {
            self.window.set_mounts(self.calibrator.radars().iter().map(|radar| radar.mount));
        }
        if let Some(pose) = self.ahead.take_if(|pose| pose.time_us <= time_us) {
            // It was checked when it came; by now the window may have left it behind.
            let _ = self.push_pose(pose);
        }
        Ok(())
    }

    /// Takes a rough pose from outside, usually GNSS. Of it and the pose believed, the better known
    /// position and the better known heading stay.
    ///
    /// # Errors
    /// When the pose is not on the map or older than the window.
    pub fn push_pose(&mut self, pose: GeoPose) -> Result<(), Error> {
        check(&pose)?;
        let time_us = pose.time_us;
        if self.window.odometry().last().is_none_or(|(newest_us, _)| time_us > newest_us) {
            self.ahead = Some(pose);
            return Ok(());
        }
        let oldest_us = self.window.oldest_us();
        let here = self.window.at(time_us).ok_or(Error::TooLate { time_us, oldest_us })?;
        let improved = self.anchor.and_then(|anchor| anchor.improved(pose, here, &self.config.drift).ok());
        self.anchor = Some(improved.unwrap_or_else(|| Anchor::new(pose, here)));
        Ok(())
    }

    /// The request of the last seconds.
    ///
    /// # Errors
    /// What is missing.
    pub fn question(&self) -> Result<LocalizationQuestion, NotReady> {
        if self.window.odometry().is_empty() {
            return Err(NotReady::NoOdometry);
        }
        let (Some(first), Some(last)) = (self.window.scans().first(), self.window.scans().last()) else {
            return Err(match self.window.speed_mps() {
                Some(speed_mps) if speed_mps < self.config.gate.min_speed_mps => {
                    NotReady::TooSlow { speed_mps }
                }
                _ => self.mostly_moving(0).map_or(NotReady::NoDetections, NotReady::AllMoving),
            });
        };
        let time_us = last.time_us;
        let odometry = self.window.at(time_us).ok_or(NotReady::NoOdometry)?;
        let anchor = self.anchor.ok_or(NotReady::NoPrior)?;
        let prior = anchor.carried(time_us, odometry, &self.config.drift)?;
        let (poses, quality) = self.corrected(first.time_us, time_us);
        // The service goes by the corrected odometry, too.
        let least_mps = self.config.gate.min_speed_mps;
        if let Some(slow) = poses.velocity_at(time_us).filter(|v| v.speed_mps() < least_mps) {
            return Err(NotReady::TooSlow { speed_mps: slow.speed_mps() });
        }
        let batch = self.batch(&poses, &quality, time_us);
        let request = v1::LocalizeRequest {
            batch: Some(batch),
            prior: Some(self.prior(&prior)),
            requirement: Some(v1::Requirement {
                integrity_risk: self.config.integrity_risk,
                alert_limit_m: self.config.alert_limits.on_the_wire_m(),
            }),
        };
        let velocity = self.window.odometry().velocity_at(time_us);
        let applied = self.calibrator.applied(first.time_us, time_us);
        Ok(LocalizationQuestion { request, time_us, odometry, velocity, applied })
    }

    /// Judges the answer to a question; one that may be used becomes the pose believed.
    ///
    /// # Errors
    /// Why the answer is not used; the pose believed stays as it was.
    pub fn accept(
        &mut self,
        question: &LocalizationQuestion,
        answer: &v1::LocalizeResponse,
    ) -> Result<Fix, Rejection> {
        if self.last_fix_us.is_some_and(|fix_us| question.time_us <= fix_us) {
            return Err(Rejection::Superseded);
        }
        let now_us = self.window.odometry().last().map_or(question.time_us, |(t, _)| t);
        let fix = verdict::judge(answer, question.time_us, now_us, &self.config)?;
        self.anchor = Some(Anchor::new(fix.pose, question.odometry));
        self.last_fix_us = Some(question.time_us);
        self.calibrate_by(&fix, question);
        Ok(fix)
    }

    /// A fix that rests on the map alone is evidence of clock and lever arm.
    fn calibrate_by(&mut self, fix: &Fix, question: &LocalizationQuestion) {
        let Some(velocity) = question.velocity.filter(|_| !fix.contains_prior) else { return };
        let body = (question.odometry.0, velocity);
        if self.calibrator.push_fix(&fix.pose, body, &question.applied) {
            self.window.set_mounts(self.calibrator.radars().iter().map(|radar| radar.mount));
        }
    }

    /// Where the vehicle believes to be at the newest odometry pose; `None` without a pose to
    /// start from.
    #[must_use]
    pub fn position(&self) -> Option<VehiclePosition> {
        let (now_us, _) = self.window.odometry().last()?;
        let pose = self.anchor?.carried(now_us, self.window.at(now_us)?, &self.config.drift).ok()?;
        let fix_age_s = self.last_fix_us.map(|fix_us| (now_us - fix_us) as f64 * 1e-6);
        Some(VehiclePosition { pose, fix_age_s })
    }

    /// The radars as they are used now: mounts and clocks, how well they are known, and what the drive says of them.
    /// Worth keeping when the trip ends: the next one may start with these mounts.
    #[must_use]
    pub fn radars(&self) -> &[RadarInUse] {
        self.calibrator.radars()
    }

    /// Detections dropped by the gates since the beginning, by the reason.
    #[must_use]
    pub fn dropped(&self) -> Dropped {
        self.window.dropped()
    }

    /// What seems to be in another convention than the contract's, by all scans and odometry so far: show it to whoever
    /// installed the vehicle.
    #[must_use]
    pub fn findings(&self) -> Vec<Finding> {
        self.window.inspection().findings()
    }

    /// The finding that the window's movers outnumber what stands.
    fn mostly_moving(&self, standing: u64) -> Option<Finding> {
        self.window.inspection().mostly_moving(self.window.dropped_lately().moving, standing)
    }

    /// Forgets the pose believed, not the window: for a vehicle whose other sensors contradict it.
    pub fn forget_position(&mut self) {
        (self.anchor, self.ahead, self.last_fix_us) = (None, None, None);
    }

    fn batch(&self, poses: &Trajectory, quality: &OdometryQuality, to_us: i64) -> v1::Batch {
        v1::Batch {
            reference_time_us: to_us,
            mounts: self.radars().iter().map(|r| wire::known_mount(&r.mount, &r.sigma)).collect(),
            scans: Some(wire::scans(self.window.scans(), to_us)),
            odometry: Some(wire::known_odometry(poses.iter().map(on_grid), quality, to_us)),
            dropped: Some(wire::dropped(&self.window.dropped_lately())),
            suspected: wire::suspected(&self.findings()),
        }
    }

    /// The odometry of a batch, corrected by what the radars say of the own velocity, and how good it is.
    fn corrected(&self, from_us: i64, to_us: i64) -> (Trajectory, OdometryQuality) {
        // One pose beyond each end, so that the ends can be interpolated.
        let mut odometry = self.window.odometry().clone();
        odometry.trim_before(from_us);
        odometry.trim_after(to_us);
        let own = self.config.odometry_quality;
        let Some(bias) = self.config.odometry_bias else { return (odometry, own) };
        // A mount that was calibrated tells odometry's errors from its own.
        let worst_rad = self.radars().iter().map(|radar| radar.sigma.yaw_rad).fold(0.0, f64::max);
        let unknown = EgoConfig::default();
        let ego = EgoConfig { mount_yaw_rad: worst_rad.clamp(0.0, unknown.mount_yaw_rad), ..unknown };
        let corrected = dedrifted(self.window.scans(), self.window.mounts(), &odometry, &ego, &bias);
        corrected.map_or((odometry, own), |corrected| (corrected.trajectory, corrected.quality))
    }

    fn prior(&self, pose: &GeoPose) -> v1::Prior {
        v1::Prior {
            pose: Some(v1::GeodeticPose {
                latitude_deg: pose.at.lat_deg,
                longitude_deg: pose.at.lon_deg,
                yaw_rad: pose.yaw_rad,
            }),
            sigma_position_m: pose.sigma_position_m.max(self.config.min_prior_sigma_position_m),
            sigma_yaw_rad: pose.sigma_yaw_rad.max(self.config.min_prior_sigma_yaw_rad),
            ..v1::Prior::default()
        }
    }
}

/// A pose on the grid on which a stream sends it in few bytes, less than a micrometre away.
fn on_grid((time_us, pose): (i64, Pose2)) -> (i64, Pose2) {
    let [x_m, y_m, yaw_rad] = delta::on_grid([pose.x_m, pose.y_m, pose.yaw_rad]);
    (time_us, Pose2::new(x_m, y_m, yaw_rad))
}

fn check(pose: &GeoPose) -> Result<(), Error> {
    let GeoPose { time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad } = *pose;
    let refuse = |reason: String| Err(Error::NotAPose { time_us, reason });
    if let Err(error) = geo::Zone::of(at) {
        return refuse(error.to_string());
    }
    if !yaw_rad.is_finite() {
        return refuse(format!("its heading is {yaw_rad}"));
    }
    let sigma = |s: f64| s.is_finite() && s >= 0.0;
    if !sigma(sigma_position_m) || !sigma(sigma_yaw_rad) {
        return refuse(format!("its one-sigma errors are {sigma_position_m} m and {sigma_yaw_rad} rad"));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
