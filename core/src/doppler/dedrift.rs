//! Odometry, corrected by the velocities the radars measured.
//!
//! Over a batch, odometry errs by a velocity that hardly changes: a slip of the wheels, a bias of the
//! gyro. So its error while it moves is taken for a straight line in time, in each of forward, left and
//! yaw rate, with a scale of the way beside it, and fitted to what the radars measure. Each interval between two estimates is compared as a whole:
//! the noise of single odometry poses cancels, for where one interval ends the next begins.
//!
//! A radar's own errors, above all a mount that is turned by some tenths of a degree, last over a batch and do not
//! average out. They are estimated along with odometry's, so that a velocity to the left that a turned mount
//! explains is hardly corrected. Where radars and odometry disagree by more than either may err (wheels
//! that slip, a wrong mount), nothing is corrected, and the odometry's quality says so.

mod fit;
mod line;

use nalgebra::Matrix6;

use super::ego::{EgoConfig, Standing, standing};
use crate::odometry::{BodyVelocity, OdometryQuality, Trajectory};
use crate::scan::{Mount, ScanView, in_time_order};
use line::{EstimateSpan, effect};

/// How odometry may err.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryBias {
    /// One-sigma error of the velocity forward, metres per second.
    pub velocity_mps: f64,
    /// The same to the left: wheels do not err there, but axes that are not the direction of travel do.
    pub left_mps: f64,
    /// One-sigma error of the yaw rate, radians per second.
    pub yaw_rate_radps: f64,
    /// One-sigma error of the way as a fraction of it: what wheels have. Without it a batch of changing speed would find it
    /// in the radars.
    pub scale: f64,
    /// Estimates that err alike: so many count as one. What stands along a street draws all of them
    /// the same way.
    pub alike: f64,
    /// Seconds of scans that make one estimate of the own velocity: so many that every radar takes
    /// part.
    pub group_s: f64,
}

impl Default for OdometryBias {
    /// A car's: wheels that err by a percent, and a gyro that the radars cannot better by much.
    fn default() -> Self {
        Self {
            velocity_mps: 0.1,
            left_mps: 0.05,
            yaw_rate_radps: 0.2_f64.to_radians(),
            scale: 0.01,
            alike: 4.0,
            group_s: 0.1,
        }
    }
}

impl OdometryBias {
    /// The largest drift of the paper (Sec. "Sensitivity to Odometric Drift"): 1 degree over 5 s.
    #[must_use]
    pub fn paper() -> Self {
        Self { left_mps: 0.08, yaw_rate_radps: 0.2_f64.to_radians(), ..Self::default() }
    }
}

/// Odometry that the radars corrected.
#[derive(Debug, Clone, PartialEq)]
pub struct Dedrifted {
    /// The way, from the same first pose; the odometry's own where `agrees` is false.
    pub trajectory: Trajectory,
    /// What was added to the velocity in the middle of the scans.
    pub correction: BodyVelocity,
    /// Covariance of (forward m/s, left m/s, yaw rate rad/s) in the middle, and of their changes from there to the
    /// end: the errors that the correction leaves, those of the scale among them.
    pub covariance: Matrix6<f64>,
    /// How good the trajectory is.
    pub quality: OdometryQuality,
    /// Whether radars and odometry agree within what either may err. Where they do not, odometry stays as it is.
    pub agrees: bool,
    /// Estimates of the own velocity it rests on.
    pub estimates: usize,
}

/// What stood still around the vehicle within a short time.
struct Estimate {
    time_us: i64,
    standing: Standing,
}

/// Estimates of the own velocity, fewer of which correct nothing.
const MIN_ESTIMATES: usize = 5;

/// Corrects odometry by the radial speeds of the scans it organises, in any order; `None` where they say too
/// little, as they do when the sensors do not measure them.
#[must_use]
pub fn dedrifted<'a, S>(
    scans: S,
    mounts: &[Mount],
    odometry: &Trajectory,
    ego: &EgoConfig,
    bias: &OdometryBias,
) -> Option<Dedrifted>
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    let estimates = estimates(scans, mounts, ego, bias);
    let span = EstimateSpan { first_us: estimates.first()?.time_us, last_us: estimates.last()?.time_us };
    if estimates.len() < MIN_ESTIMATES {
        return None;
    }
    let compared = beside_odometry(estimates, odometry, bias);
    let fit::Fitted { line, covariance, agrees } = fit::fitted(&compared, mounts.len(), &span, ego, bias)?;
    let estimates = compared.len();
    let effect =
        effect(compared.iter().map(|(estimate, v)| (span.fraction(estimate.time_us), v.forward_mps)));
    let (mean, covariance) = (effect * line, effect * covariance * effect.transpose());
    if !agrees {
        let quality = quality_of(&(covariance + mean * mean.transpose()));
        let (trajectory, correction) = (odometry.clone(), BodyVelocity::default());
        return Some(Dedrifted { trajectory, correction, covariance, quality, agrees, estimates });
    }
    let correction = BodyVelocity { forward_mps: mean[0], left_mps: mean[1], yaw_rate_radps: mean[2] };
    let (trajectory, quality) = (span.corrected(odometry, &line)?, quality_of(&covariance));
    Some(Dedrifted { trajectory, correction, covariance, quality, agrees, estimates })
}

/// The worse of the two axes, and of the middle and the change.
fn quality_of(covariance: &Matrix6<f64>) -> OdometryQuality {
    let sigma = |axes: &[usize]| axes.iter().map(|i| covariance[(*i, *i)]).fold(0.0, f64::max).sqrt();
    OdometryQuality {
        velocity_mps: sigma(&[0, 1, 3, 4]),
        velocity_fraction: 0.0,
        yaw_rate_radps: sigma(&[2, 5]),
    }
}

/// What stands still, by times of [`OdometryBias::group_s`].
fn estimates<'a, S>(scans: S, mounts: &[Mount], ego: &EgoConfig, bias: &OdometryBias) -> Vec<Estimate>
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    let scans: Vec<ScanView<'a>> = scans.into_iter().map(Into::into).collect();
    let scans = in_time_order(scans.iter().copied()).unwrap_or(scans);
    let group_us = (bias.group_s * 1e6) as i64;
    let groups = scans.chunk_by(|a, b| a.time_us.div_euclid(group_us) == b.time_us.div_euclid(group_us));
    let estimate = |group: &[ScanView<'a>]| {
        // The time of the detections, not of the scans: few of them come from a radar that sees little.
        let (first_us, mut rows, mut offset_us) = (group[0].time_us, 0, 0);
        for scan in group {
            rows += scan.range_m.len() as i64;
            offset_us += (scan.time_us - first_us) * scan.range_m.len() as i64;
        }
        let standing = standing(group.iter().copied(), mounts, ego)?;
        Some(Estimate { time_us: first_us + offset_us / rows.max(1), standing })
    };
    groups.filter_map(estimate).collect()
}

/// Estimates with odometry's velocity over the same time; those that odometry does not cover are left out.
fn beside_odometry(
    estimates: Vec<Estimate>,
    odometry: &Trajectory,
    bias: &OdometryBias,
) -> Vec<(Estimate, BodyVelocity)> {
    let times: Vec<_> = estimates.iter().map(|estimate| estimate.time_us).collect();
    let half_us = (bias.group_s * 0.5e6) as i64;
    let beside = |(index, estimate): (usize, Estimate)| {
        let time_us = times[index];
        // No longer than a group: an estimate says nothing of a stop that comes before or after it.
        let middle = |other: Option<&i64>| {
            let middle = other.map_or(time_us, |t| i64::midpoint(*t, time_us));
            middle.clamp(time_us - half_us, time_us + half_us)
        };
        let before = index.checked_sub(1).and_then(|before| times.get(before));
        let (from_us, to_us) = (middle(before), middle(times.get(index + 1)));
        Some((estimate, odometry.velocity_between(from_us, to_us)?))
    };
    estimates.into_iter().enumerate().filter_map(beside).collect()
}

#[cfg(test)]
mod tests;
