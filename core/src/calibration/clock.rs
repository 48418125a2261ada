//! Does one batch show that its radars' clock is off?
//!
//! A caller that sends radial speeds sends all that it takes: while the batch brakes, starts or turns, the radial speeds
//! lag behind odometry. Five seconds at one speed say nothing, and then nothing is claimed.

use super::{CalibrationConfig, Estimated, SelfCalibration};
use crate::odometry::{BodyVelocity, Trajectory};
use crate::scan::{Mount, ScanView, in_time_order};

/// A clock that differs less is within what is usual, seconds.
const LEAST_S: f64 = 0.015;
/// Sigmas from which on a difference is one.
const SIGMAS: f64 = 4.0;
/// Scans that are looked at, evenly spread: more make it costlier, not surer.
const SCANS: usize = 120;
/// Errors are alike within stretches of this length, seconds.
const STRETCH_S: f64 = 0.5;
/// A batch whose speed changes by less says nothing, metres per second, nor one whose yaw rate does, radians a second.
const LEAST_CHANGE_MPS: f64 = 1.0;
const LEAST_CHANGE_RADPS: f64 = 0.15;

/// Seconds by which the stamps of a batch's scans come after the moments they show, where the batch shows clearly that
/// they do (late) or that they come before them (negative); `None` where it does not.
#[must_use]
pub fn clock_of_batch<'a, S>(scans: S, mounts: &[Mount], odometry: &Trajectory) -> Option<Estimated>
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    let scans: Vec<ScanView<'a>> = scans.into_iter().map(Into::into).collect();
    let scans = in_time_order(scans.iter().copied()).unwrap_or(scans);
    if scans.iter().all(|scan| scan.radial_speed_mps.is_empty()) || !changes(&scans, odometry) {
        return None;
    }
    let config = CalibrationConfig { stretch_s: STRETCH_S, ..CalibrationConfig::default() };
    let mut calibration = SelfCalibration::new(config, mounts);
    // Radars take turns: a step that is not a multiple of their number sees all of them.
    let step = (scans.len() / SCANS).max(1);
    let step = if step > 1 && step.is_multiple_of(mounts.len().max(1)) { step + 1 } else { step };
    for scan in scans.iter().step_by(step) {
        calibration.add(*scan, odometry);
    }
    let clocks = (0..mounts.len()).filter_map(|sensor| Some(calibration.radar(sensor)?.late_s));
    // Odometry's errors are common to all: together the radars know no better than the best of them.
    let best = clocks.clone().map(|clock| clock.sigma).min_by(f64::total_cmp)?;
    let clock = Estimated::mean(clocks, best)?;
    (clock.is_beyond(SIGMAS) && clock.value.abs() > LEAST_S).then_some(clock)
}

/// True when the motion changes enough within the scans for a delay to show.
fn changes(scans: &[ScanView<'_>], odometry: &Trajectory) -> bool {
    let (Some(first), Some(last)) = (scans.first(), scans.last()) else { return false };
    let from_us = odometry.first().map_or(first.time_us, |(t, _)| t.max(first.time_us));
    let to_us = odometry.last().map_or(last.time_us, |(t, _)| t.min(last.time_us));
    let half_second = |t: &i64| odometry.velocity_between(*t, t + 500_000);
    let starts = (0..64).map(|i| from_us.saturating_add(i * 500_000)).take_while(|t| t + 500_000 <= to_us);
    let velocities: Vec<_> = starts.filter_map(|t| half_second(&t)).collect();
    let span = |value: fn(&BodyVelocity) -> f64| {
        let values = velocities.iter().map(value);
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    span(|v| v.forward_mps) > LEAST_CHANGE_MPS || span(|v| v.yaw_rate_radps) > LEAST_CHANGE_RADPS
}
