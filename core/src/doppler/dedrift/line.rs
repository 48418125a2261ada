//! The error of odometry's velocity over a batch: a straight line in time, and a scale of the way.

use nalgebra::{SMatrix, SVector};

use crate::odometry::{BodyVelocity, Trajectory};
use crate::pose::Pose2;

/// Numbers of the error: (forward, left, yaw rate) in the middle, how they change from there to the end, and the scale.
pub(super) const SIZE: usize = 7;
/// Index of the scale among them.
pub(super) const SCALE: usize = 6;

/// The error.
pub(super) type VelocityError = SVector<f64, SIZE>;

/// Odometry that is slower says that the body stands, metres per second.
const STANDING_MPS: f64 = 0.05;

/// The time from the first estimate to the last.
pub(super) struct EstimateSpan {
    pub first_us: i64,
    pub last_us: i64,
}

impl EstimateSpan {
    /// -1 at the first estimate and before, 1 at the last and after.
    pub(super) fn fraction(&self, time_us: i64) -> f64 {
        let (middle, half) =
            (i64::midpoint(self.first_us, self.last_us), (self.last_us - self.first_us) as f64 / 2.0);
        ((time_us - middle) as f64 / half.max(1.0)).clamp(-1.0, 1.0)
    }

    /// Error of the velocity at a time at which odometry says a velocity, as a matrix on the error's numbers.
    pub(super) fn design(&self, time_us: i64, odometric: &BodyVelocity) -> SMatrix<f64, 3, SIZE> {
        let fraction = self.fraction(time_us);
        let mut design = SMatrix::zeros();
        for axis in 0..3 {
            design[(axis, axis)] = 1.0;
            design[(axis, axis + 3)] = fraction;
        }
        // Along the way, which points forward: what is left of a step to the side is noise or the turn of its frame.
        design[(0, SCALE)] = odometric.forward_mps;
        design
    }

    /// The way with every step corrected.
    pub(super) fn corrected(&self, odometry: &Trajectory, error: &VelocityError) -> Option<Trajectory> {
        let (mut last_us, mut last) = odometry.first()?;
        let mut pose = last;
        let mut corrected = Trajectory::new([(last_us, pose)]).ok()?;
        for (time_us, next) in odometry.iter().skip(1) {
            let dt_s = (time_us - last_us) as f64 * 1e-6;
            let step = last.between(&next);
            let way_m = step.x_m.hypot(step.y_m);
            // Wheels that stand do not err, and neither does a gyro that knows it.
            let moved_s = if way_m > STANDING_MPS * dt_s { dt_s } else { 0.0 };
            let forward_mps = (way_m / dt_s).copysign(step.x_m);
            let odometric = BodyVelocity { forward_mps, ..BodyVelocity::default() };
            let added = self.design(i64::midpoint(last_us, time_us), &odometric) * error * moved_s;
            // What is added points along the body half-way through the step's turn.
            let (s, c) = (0.5 * (step.yaw_rad + added.z)).sin_cos();
            pose = pose.compose(&Pose2::new(
                step.x_m + c * added.x - s * added.y,
                step.y_m + s * added.x + c * added.y,
                step.yaw_rad + added.z,
            ));
            corrected.push(time_us, pose).ok()?;
            (last_us, last) = (time_us, next);
        }
        Some(corrected)
    }
}

/// What an error amounts to in the middle and in the change from there to the end, as a matrix on its numbers: the scale
/// errs by the speed, which is some line of its own. Of fractions of the span, and speeds there.
pub(super) fn effect(speeds: impl Iterator<Item = (f64, f64)>) -> SMatrix<f64, 6, SIZE> {
    let (mut count, mut f, mut ff, mut v, mut fv) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (fraction, speed_mps) in speeds {
        count += 1.0;
        f += fraction;
        ff += fraction * fraction;
        v += speed_mps;
        fv += fraction * speed_mps;
    }
    let mut effect = SMatrix::identity();
    let spread = count * ff - f * f;
    let change = if spread > 1e-9 * count * count { (count * fv - f * v) / spread } else { 0.0 };
    effect[(0, SCALE)] = (v - change * f) / f64::max(count, 1.0);
    effect[(3, SCALE)] = change;
    effect
}
