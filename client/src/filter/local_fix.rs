//! A fix in the local plane, at the time it really measures.

use echofix_core::pose::Pose2;
use nalgebra::Matrix3;

use super::config::FixNoise;
use super::noise::Split;

/// What a batch measured, at its middle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LocalFix {
    /// The time the fix is for, microseconds since the Unix epoch.
    pub(super) end_us: i64,
    /// The pose at the middle of the batch.
    pub(super) pose: Pose2,
    /// How it errs.
    pub(super) noise: Split,
}

impl LocalFix {
    /// The fix of a pose at the end of a batch, brought back along odometry's way from the middle:
    /// an error of the heading swings the way.
    pub(super) fn new(
        end_us: i64,
        (end, covariance): (Pose2, &Matrix3<f64>),
        middle_to_end: &Pose2,
        noise: &FixNoise,
    ) -> Self {
        let pose = end.compose(&middle_to_end.inverse());
        let (x_m, y_m) = (end.x_m - pose.x_m, end.y_m - pose.y_m);
        let swing = Matrix3::new(1.0, 0.0, y_m, 0.0, 1.0, -x_m, 0.0, 0.0, 1.0);
        Self { end_us, pose, noise: Split::of(&(swing * covariance * swing.transpose()), noise) }
    }

    /// The same fix in a plane in which the old one's origin has this pose.
    pub(super) fn moved_to(&self, old_origin: &Pose2) -> Self {
        let (sin, cos) = old_origin.yaw_rad.sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let batch = turn * self.noise.batch * turn.transpose();
        Self { pose: old_origin.compose(&self.pose), noise: Split { batch, ..self.noise }, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn the_heading_s_error_swings_the_way_back() {
        // North for 20 m, the heading known to 0.01 rad: 0.2 m east at the middle.
        let end = Pose2::new(3.0, 24.0, std::f64::consts::FRAC_PI_2);
        let covariance = Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, 1e-4));
        let noise = FixNoise { map_m: 0.0, map_rad: 0.0, ..FixNoise::default() };
        let fix = LocalFix::new(7, (end, &covariance), &Pose2::new(20.0, 0.0, 0.0), &noise);
        assert!(fix.pose.distance_m(&Pose2::new(3.0, 4.0, 0.0)) < 1e-9, "{fix:?}");
        let whole = fix.noise.batch * fix.noise.batch.transpose() - fix.noise.fresh;
        assert!((whole[(0, 0)] - 0.04).abs() < 1e-9 && whole[(1, 1)].abs() < 1e-9, "{whole}");
        // Turned left too far at the end, the middle is thought too far east.
        assert!((whole[(0, 2)] - 0.002).abs() < 1e-9, "{whole}");
    }
}
