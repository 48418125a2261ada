//! What odometry says of the way between two times, and how it errs.

use echofix_core::pose::Pose2;

use super::config::FilterConfig;

/// Odometry that moves less than this, metres and radians, is clamped at standstill: no sensor is
/// that quiet.
const STANDSTILL: f64 = 1e-9;

/// A way and the time it took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OdometryStep {
    /// Seconds, not negative.
    pub(super) time_s: f64,
    /// The later pose as seen from the earlier.
    pub(super) moved: Pose2,
}

impl OdometryStep {
    /// From one (microseconds, odometry pose) to a later one.
    pub(super) fn between((from_us, from): (i64, Pose2), (to_us, to): (i64, Pose2)) -> Self {
        Self { time_s: to_us.saturating_sub(from_us) as f64 * 1e-6, moved: from.between(&to) }
    }

    /// For how long the gyro was integrated, seconds: not while odometry is clamped at standstill.
    pub(super) fn turning_s(&self) -> f64 {
        let clamped = self.way_m() < STANDSTILL && self.moved.yaw_rad.abs() < STANDSTILL;
        if clamped { 0.0 } else { self.time_s }
    }

    /// Variances that odometry's random walk adds to x, y (square metres) and yaw (square radians).
    pub(super) fn walk(&self, config: &FilterConfig) -> [f64; 3] {
        let position = config.odometry.walk_m.powi(2) * self.way_m();
        [position, position, config.odometry.walk_rad.powi(2) * self.turning_s()]
    }

    /// For each Gauss-Markov state, in the order of the states: its sigma when nothing is known of
    /// it, and the fraction of what is known that the step leaves.
    pub(super) fn memory(&self, config: &FilterConfig) -> [(f64, f64); 8] {
        let (odometry, fixes) = (config.odometry, config.fixes);
        let left = |passed: f64, length: f64| (-passed / length).exp();
        let map = left(self.way_m(), fixes.map_way_m);
        // Two batches of length T, t apart, share 1 - t/T of their detections; the exponential of
        // the same integral has the time constant T/2.
        let batch = (1.0, left(self.time_s, 0.5 * fixes.batch_s));
        [
            (odometry.scale, left(self.time_s, odometry.scale_time_s)),
            (odometry.yaw_rate_radps, left(self.time_s, odometry.yaw_rate_time_s)),
            (fixes.map_m, map),
            (fixes.map_m, map),
            (fixes.map_rad, map),
            batch,
            batch,
            batch,
        ]
    }

    fn way_m(&self) -> f64 {
        self.moved.x_m.hypot(self.moved.y_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clamped_gyro_does_not_turn_and_a_quiet_one_does() {
        let far = Pose2::new(1234.5, -987.6, -2.1);
        assert!(OdometryStep::between((0, far), (50_000, far)).turning_s() < 1e-12);
        let turned = Pose2 { yaw_rad: far.yaw_rad + 1e-7, ..far };
        assert!((OdometryStep::between((0, far), (50_000, turned)).turning_s() - 0.05).abs() < 1e-12);
    }

    #[test]
    fn what_is_forgotten_depends_on_time_or_on_way() {
        let config = FilterConfig::default();
        let left = |time_s: f64, way_m: f64| {
            let moved = Pose2::new(way_m, 0.0, 0.0);
            OdometryStep { time_s, moved }.memory(&config).map(|(_, left)| left)
        };
        // Waiting makes batches new, not the map; the way makes the map new.
        let waited = left(60.0, 0.0);
        assert!(waited[5] < 1e-9 && waited[2] > 0.999, "{waited:?}");
        let driven = left(0.1, 500.0);
        assert!(driven[2] < 1e-4 && driven[5] > 0.9, "{driven:?}");
    }
}
