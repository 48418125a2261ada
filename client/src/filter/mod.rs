//! The reference filter: odometry and fixes in, a smooth pose with an honest covariance out.
//!
//! For those who integrate Echofix and have no filter of their own to feed, or want one to compare
//! theirs with. Like the [`Vehicle`](crate::vehicle::Vehicle) it has no clock and no network: now is
//! the time of the newest odometry pose.
//!
//! ```no_run
//! use echofix_client::filter::{self, Filter};
//! use echofix_client::vehicle::{self, Vehicle};
//! use echofix_client::{Localizer, LocalizerOptions, drivelog, drivelog::DriveEvent, service::ServiceAddress};
//! # async fn run(drive: echofix_core::drive::Drive) -> Result<(), Box<dyn std::error::Error>> {
//! let localizer = Localizer::new(ServiceAddress::at("http://127.0.0.1:50051").endpoint()?, LocalizerOptions::default());
//! let mut vehicle = Vehicle::new(vehicle::VehicleConfig::default(), drive.mounts.clone());
//! let mut filter = Filter::new(filter::FilterConfig::default());
//! for event in drivelog::replay(&drive) {
//!     match event {
//!         DriveEvent::Odometry(time_us, pose) => {
//!             vehicle.push_odometry(time_us, pose)?;
//!             filter.push_odometry(time_us, pose)?;
//!         }
//!         DriveEvent::Scan(scan) => vehicle.push_scan(scan.clone())?,
//!         DriveEvent::Reference(rough) => vehicle.push_pose(*rough)?,
//!         DriveEvent::Truth(_) => continue,
//!     }
//!     // Once a second will do.
//!     let Ok(question) = vehicle.question() else { continue };
//!     let Ok(answer) = localizer.ask(&question).await else { continue };
//!     if let Ok(fix) = vehicle.accept(&question, &answer) {
//!         let outcome = filter.push_fix(&(&fix).into())?;
//!         println!("{outcome:?}: {:?}", filter.pose());
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! # States
//!
//! An extended Kalman filter in a local plane of ground metres, x true east and y true north at its
//! origin, which follows the fixes and knows no zone border.
//!
//! | state | unit | between fixes |
//! |---|---|---|
//! | x, y, yaw | m, m, rad | moved by odometry, less its learnt errors; a random walk |
//! | scale error of odometry | 1 | Gauss-Markov in time: tyres |
//! | yaw rate error of odometry | rad/s | Gauss-Markov in time: a gyro's bias |
//! | the map's own error (3) | m, m, rad | Gauss-Markov in the way driven |
//! | the batch's error (3) | the fix's sigmas | Gauss-Markov in time |
//!
//! With `d` the increment of odometry, `s` and `b` its two errors: `p' = p + R(yaw) (1 - s) d` and
//! `yaw' = yaw + d_yaw - b dt`. Odometry that is clamped at standstill is taken to clamp its gyro,
//! too.
//!
//! # The errors of fixes are not white
//!
//! A fix is `pose + map + batch + a little of its own`. Its covariance says how large the sum is; the
//! filter only splits it. What would be averaged away if every fix were taken for news is held in
//! states instead (Bryson and Henrikson, "Estimation using sampled data containing sequentially
//! correlated noise", 1968):
//!
//! - *The map's own error* is common to all fixes of a street. It fades over [`FixNoise::map_way_m`]
//!   metres driven, so standing still for an hour teaches nothing about it.
//! - *The batch's error* is common to the fixes whose batches overlap. It fades over half a batch, and
//!   ten fixes a second are worth little more than one.
//!
//! ## A fix is for the middle of its batch
//!
//! The service gets the batch as odometry has organised it and answers for its newest scan, but what
//! it can see is where the batch as a whole lies. Odometry that is 0.5 % short puts the answer 10 cm
//! behind at 8 m/s and 5 s, fix after fix, and no averaging helps. So the filter goes back from the
//! fix along the same odometry to the middle of the batch, takes the fix into account there, and
//! comes forward again with the errors it has learnt taken off.
//!
//! # Late, early, out of order
//!
//! The last [`FilterConfig::history_s`] are stored: odometry, fixes, and what was believed. A fix goes where
//! it belongs, and all after it is done again; the order of arrival makes no difference. What is older
//! is [`FixOutcome::TooOld`], what odometry does not cover yet [`FixOutcome::AheadOfOdometry`].
//!
//! # Doubt
//!
//! A fix must pass a chi-square gate on its innovation. The filter itself may be wrong, so fixes
//! that do not pass are remembered: [`Recovery::agreeing`] in a row that pass *each other's* gate, and
//! between them span [`Recovery::span_s`], overrule it. It starts in the same way, so that one wrong
//! fix does not: there is no estimate before three fixes agree.
//!
//! A fix that [contains its prior](FixMeasurement::contains_prior) is used only if that prior was
//! [independent](PriorSource::Independent) of this filter.
//!
//! # Tuning
//!
//! - [`OdometryNoise`] is the vehicle's own and worth measuring: drive a straight kilometre, and stand
//!   for a minute. Too small, and the filter trusts odometry over fixes; the sign is
//!   [`FilterEstimate::contradicting`].
//! - [`FixNoise::map_m`] decides how good the filter can claim to be: it is averaged only over ways
//!   much longer than [`FixNoise::map_way_m`]. When in doubt, make both larger.
//! - The gate's false alarms cost one fix, so it may be tight; a heavier tail of good fixes shows as
//!   [`FixOutcome::Gated`] with a `nis` of some tens.
//! - `cargo run -p echofix-client --example filter` compares with the last fix carried on by odometry,
//!   on simulated drives; `--example fuse` does it on a drive log and a running service. A mean NEES
//!   above 4 or so says that a sigma is too small.
//!
//! # Rooms
//!
//! From the ground up: `config`, `plane`, `noise` (whose error is whose), `local_fix`,
//! `step` (odometry), `belief` (the Kalman filter), `track` (gate and recovery), `history` (time),
//! `estimate` (what is returned).

mod belief;
mod config;
mod estimate;
mod history;
mod local_fix;
mod measurement;
mod noise;
mod plane;
mod step;
mod track;

pub use config::{FilterConfig, FixNoise, OdometryNoise, Recovery};
pub use estimate::FilterEstimate;
pub use measurement::{Error, FixMeasurement, FixOutcome, PriorSource};

use echofix_core::geo::LatLon;
use echofix_core::pose::Pose2;

use history::History;
use local_fix::LocalFix;
use plane::LocalPlane;

/// How far from its origin the local plane is used, metres.
const FRAME_REACH_M: f64 = 2_000.0;

/// Fuses odometry with fixes; see the [module](self).
#[derive(Debug, Clone)]
pub struct Filter {
    config: FilterConfig,
    /// Chosen by the first fix.
    frame: Option<LocalPlane>,
    history: History,
}

impl Filter {
    /// A filter that knows nothing yet.
    #[must_use]
    pub fn new(config: FilterConfig) -> Self {
        Self { config, frame: None, history: History::default() }
    }

    /// Takes an odometry pose: microseconds since the Unix epoch, and the pose of the body in any
    /// frame that stays the same.
    ///
    /// # Errors
    /// When the time does not increase or the pose is not finite, and the pose is not taken; or when
    /// it jumped, and the filter starts over from it.
    pub fn push_odometry(&mut self, time_us: i64, pose: Pose2) -> Result<(), Error> {
        self.history.push(time_us, pose, &self.config)
    }

    /// Takes a fix for any time within the history, in any order, and says what became of it.
    ///
    /// # Errors
    /// When it is not a fix.
    pub fn push_fix(&mut self, fix: &FixMeasurement) -> Result<FixOutcome, Error> {
        let covariance = fix.checked()?;
        if fix.contains_prior && fix.prior == PriorSource::Own {
            return Ok(FixOutcome::HoldsOwnPrior);
        }
        let middle = match self.history.middle(fix.time_us, &self.config) {
            Ok(middle) => middle,
            Err(outcome) => return Ok(outcome),
        };
        let frame = self.frame_for(fix.at)?;
        let end = frame.local(fix.at, fix.yaw_rad)?;
        let local = LocalFix::new(fix.time_us, (end, &covariance), &middle.to_end, &self.config.fixes);
        let outcome = self.history.insert(middle.time_us, local, &self.config);
        if matches!(outcome, FixOutcome::Used { .. } | FixOutcome::Started | FixOutcome::Reset { .. }) {
            self.follow(&frame, fix.at, &end)?;
        }
        Ok(outcome)
    }

    /// Where the vehicle is at the newest odometry pose; `None` until enough fixes agreed, and after
    /// so long a way without any that the estimate is worth nothing.
    #[must_use]
    pub fn pose(&self) -> Option<FilterEstimate> {
        let (time_us, track) = self.history.newest(&self.config)?;
        FilterEstimate::of(time_us, &track, &self.frame?)
    }

    /// The plane for a fix: that of the first, unless that led nowhere.
    fn frame_for(&mut self, at: LatLon) -> Result<LocalPlane, Error> {
        if let Some(frame) = self.frame.filter(|frame| frame.reaches(at)) {
            return Ok(frame);
        }
        let believing = self.history.newest(&self.config).is_some_and(|(_, track)| track.belief().is_some());
        if believing {
            return Err(Error::FarAway { at });
        }
        let frame = LocalPlane::around(at)?;
        self.history.forget_fixes();
        self.frame = Some(frame);
        Ok(frame)
    }

    /// Moves the local plane along once a fix is far from its origin.
    fn follow(&mut self, frame: &LocalPlane, at: LatLon, local: &Pose2) -> Result<(), Error> {
        if local.distance_m(&Pose2::IDENTITY) > FRAME_REACH_M {
            let old_origin = frame.local(at, 0.0)?.inverse();
            self.frame = Some(LocalPlane::around(at)?);
            self.history.move_to(&old_origin);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
