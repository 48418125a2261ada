//! Odometry's velocity and how it changes.

use crate::odometry::{BodyVelocity, Trajectory};

/// The body's motion around one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Velocity in the body's frame.
    pub velocity: BodyVelocity,
    /// Its change per second.
    pub change: BodyVelocity,
}

/// Half of the time over which a velocity is taken, microseconds: the noise of single poses averages out, and a car's
/// speed hardly bends.
const HALF_US: i64 = 50_000;
/// The change is taken between velocities this long before and after, microseconds: so far that the three share no
/// pose, whose noise would make the velocity look like its change.
const APART_US: i64 = 200_000;
/// A car that changes faster does so on paper only: its odometry jumped.
const MAX_CHANGE_MPS2: f64 = 12.0;
const MAX_TURN_CHANGE_RADPS2: f64 = 6.0;

impl Motion {
    /// Around a time; `None` where odometry does not reach a quarter of a second to both sides, and where it jumps.
    #[must_use]
    pub fn around(odometry: &Trajectory, time_us: i64) -> Option<Self> {
        let at = |t: i64| odometry.velocity_between(t.checked_sub(HALF_US)?, t.checked_add(HALF_US)?);
        let velocity = at(time_us)?;
        let (before, after) = (at(time_us.checked_sub(APART_US)?)?, at(time_us.checked_add(APART_US)?)?);
        let per_second = 1e6 / (2 * APART_US) as f64;
        let change = BodyVelocity {
            forward_mps: (after.forward_mps - before.forward_mps) * per_second,
            left_mps: (after.left_mps - before.left_mps) * per_second,
            yaw_rate_radps: (after.yaw_rate_radps - before.yaw_rate_radps) * per_second,
        };
        let sane = change.speed_mps() <= MAX_CHANGE_MPS2
            && change.yaw_rate_radps.abs() <= MAX_TURN_CHANGE_RADPS2
            && between(velocity.forward_mps, before.forward_mps, after.forward_mps);
        sane.then_some(Self { velocity, change })
    }
}

/// True when a speed lies between two others, or hardly outside: a jump within the middle shows in it alone.
fn between(middle: f64, before: f64, after: f64) -> bool {
    const SLACK_MPS: f64 = 1.5;
    (before.min(after) - SLACK_MPS..=before.max(after) + SLACK_MPS).contains(&middle)
}
