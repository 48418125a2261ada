//! What the filter returns.

use echofix_core::drive::GeoPose;

use super::plane::LocalPlane;
use super::track::Track;

/// Where the vehicle is, at the time of the newest odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterEstimate {
    /// The pose of the body, with the sigmas of `covariance`.
    pub pose: GeoPose,
    /// Covariance of (east m, north m, yaw rad): upper triangle row by row.
    pub covariance: [f64; 6],
    /// Seconds since the time of the last fix used.
    pub fix_age_s: f64,
    /// Fixes in a row that contradict this estimate and agree with each other: 0 is healthy.
    pub contradicting: usize,
    /// Fraction by which odometry's distances are too long, and its sigma.
    pub odometry_scale: (f64, f64),
    /// What odometry's yaw rate is too large by, and its sigma, radians per second.
    pub odometry_yaw_rate_radps: (f64, f64),
}

impl FilterEstimate {
    /// What a track believes; `None` while it believes nothing.
    pub(super) fn of(time_us: i64, track: &Track, frame: &LocalPlane) -> Option<Self> {
        let belief = track.belief()?;
        let (at, yaw_rad) = frame.geodetic(&belief.pose()).ok()?;
        let p = belief.pose_covariance();
        let covariance = [p[(0, 0)], p[(0, 1)], p[(0, 2)], p[(1, 1)], p[(1, 2)], p[(2, 2)]];
        let (sigma_position_m, sigma_yaw_rad) = (larger_axis_m(&covariance), p[(2, 2)].sqrt());
        Some(Self {
            pose: GeoPose { time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad },
            covariance,
            fix_age_s: time_us.saturating_sub(track.last_fix_us()?) as f64 * 1e-6,
            contradicting: track.rivals(),
            odometry_scale: belief.scale(),
            odometry_yaw_rate_radps: belief.yaw_rate_radps(),
        })
    }
}

/// One sigma along the larger axis of the error ellipse, metres.
fn larger_axis_m([east, between, _, north, _, _]: &[f64; 6]) -> f64 {
    (0.5 * (east + north) + (0.5 * (east - north)).hypot(*between)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_larger_axis_lies_between_the_axes_too() {
        assert!((larger_axis_m(&[0.5, 0.4, 0.0, 0.5, 0.0, 1.0]) - 0.9_f64.sqrt()).abs() < 1e-12);
        assert!((larger_axis_m(&[0.04, 0.0, 0.0, 0.25, 0.0, 1.0]) - 0.5).abs() < 1e-12);
    }
}
