//! The extended Kalman filter itself: what is believed at one time, carried and corrected.

use echofix_core::pose::{Pose2, wrap_angle};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::config::FilterConfig;
use super::local_fix::LocalFix;
use super::measurement::{MAX_SIGMA_M, MAX_SIGMA_RAD};
use super::step::OdometryStep;

type Vector = SVector<f64, 11>;
type Covariance = SMatrix<f64, 11, 11>;
type Jacobian = SMatrix<f64, 3, 11>;

// Where the states lie in the vector. The first three are x, y, yaw.
const YAW: usize = 2;
const SCALE: usize = 3;
const YAW_RATE: usize = 4;
const MAP: usize = 5;
const BATCH: usize = 8;

/// Mean and covariance of the states at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Belief {
    mean: Vector,
    covariance: Covariance,
}

/// How a fix differs from what was expected.
#[derive(Debug, Clone, Copy)]
pub(super) struct Innovation {
    residual: Vector3<f64>,
    inverse: Matrix3<f64>,
    jacobian: Jacobian,
    fresh: Matrix3<f64>,
    /// Normalised innovation squared.
    pub(super) nis: f64,
}

impl Belief {
    /// The belief of a first fix alone.
    pub(super) fn from_fix(fix: &LocalFix, config: &FilterConfig) -> Self {
        let (odometry, fixes) = (config.odometry, config.fixes);
        let sigma = [
            // Nothing is known yet. Larger would only cost digits.
            1e3,
            1e3,
            3.0,
            odometry.scale,
            odometry.yaw_rate_radps,
            fixes.map_m,
            fixes.map_m,
            fixes.map_rad,
            1.0,
            1.0,
            1.0,
        ];
        let mut mean = Vector::zeros();
        mean[0] = fix.pose.x_m;
        mean[1] = fix.pose.y_m;
        mean[YAW] = fix.pose.yaw_rad;
        let covariance = Covariance::from_diagonal(&Vector::from(sigma.map(|s| s * s)));
        let vague = Self { mean, covariance };
        vague.innovation(fix).map_or(vague, |innovation| vague.corrected(&innovation))
    }

    /// The belief after a way; `None` once it is too vague to be one.
    pub(super) fn carried(&self, step: &OdometryStep, config: &FilterConfig) -> Option<Self> {
        let (moved, turning_s) = (step.moved, step.turning_s());
        let (sin, cos) = self.mean[YAW].sin_cos();
        let (ahead_x, ahead_y) = (cos * moved.x_m - sin * moved.y_m, sin * moved.x_m + cos * moved.y_m);
        let true_fraction = 1.0 - self.mean[SCALE];

        let mut mean = self.mean;
        mean[0] += true_fraction * ahead_x;
        mean[1] += true_fraction * ahead_y;
        mean[YAW] = wrap_angle(mean[YAW] + moved.yaw_rad - turning_s * mean[YAW_RATE]);
        let mut transition = Covariance::identity();
        transition[(0, YAW)] = -true_fraction * ahead_y;
        transition[(1, YAW)] = true_fraction * ahead_x;
        transition[(0, SCALE)] = -ahead_x;
        transition[(1, SCALE)] = -ahead_y;
        transition[(YAW, YAW_RATE)] = -turning_s;

        let mut noise = Vector::zeros();
        noise.fixed_rows_mut::<3>(0).copy_from_slice(&step.walk(config));
        for (state, (sigma, left)) in (SCALE..).zip(step.memory(config)) {
            mean[state] *= left;
            transition[(state, state)] = left;
            noise[state] = sigma * sigma * (1.0 - left * left);
        }
        let covariance =
            transition * self.covariance * transition.transpose() + Covariance::from_diagonal(&noise);
        Some(Self { mean, covariance: symmetric(&covariance) }).filter(Self::is_sound)
    }

    /// How a fix differs from what this belief expects; `None` where numbers fail.
    pub(super) fn innovation(&self, fix: &LocalFix) -> Option<Innovation> {
        let mut jacobian = Jacobian::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        jacobian.fixed_view_mut::<3, 3>(0, MAP).set_diagonal(&fix.noise.map);
        jacobian.fixed_view_mut::<3, 3>(0, BATCH).copy_from(&fix.noise.batch);
        let measured = Vector3::new(fix.pose.x_m, fix.pose.y_m, fix.pose.yaw_rad);
        let mut residual = measured - jacobian * self.mean;
        residual[2] = wrap_angle(residual[2]);
        let expected = jacobian * self.covariance * jacobian.transpose() + fix.noise.fresh;
        let inverse = expected.cholesky()?.inverse();
        let nis = residual.dot(&(inverse * residual));
        nis.is_finite().then_some(Innovation { residual, inverse, jacobian, fresh: fix.noise.fresh, nis })
    }

    /// The belief with a fix taken into account.
    pub(super) fn corrected(&self, innovation: &Innovation) -> Self {
        let Innovation { residual, inverse, jacobian, fresh, .. } = innovation;
        let gain = self.covariance * jacobian.transpose() * inverse;
        let mut mean = self.mean + gain * residual;
        mean[YAW] = wrap_angle(mean[YAW]);
        // Joseph's form stays positive whatever is rounded.
        let rest = Covariance::identity() - gain * jacobian;
        let covariance = rest * self.covariance * rest.transpose() + gain * fresh * gain.transpose();
        Self { mean, covariance: symmetric(&covariance) }
    }

    /// The same belief in a plane in which the old one's origin has this pose.
    pub(super) fn moved_to(&self, old_origin: &Pose2) -> Self {
        let mut turn = Covariance::identity();
        let (sin, cos) = old_origin.yaw_rad.sin_cos();
        for at in [0, MAP, BATCH] {
            turn[(at, at)] = cos;
            turn[(at, at + 1)] = -sin;
            turn[(at + 1, at)] = sin;
            turn[(at + 1, at + 1)] = cos;
        }
        let mut mean = turn * self.mean;
        let pose = old_origin.compose(&self.pose());
        mean[0] = pose.x_m;
        mean[1] = pose.y_m;
        mean[YAW] = pose.yaw_rad;
        Self { mean, covariance: symmetric(&(turn * self.covariance * turn.transpose())) }
    }

    pub(super) fn pose(&self) -> Pose2 {
        Pose2::new(self.mean[0], self.mean[1], self.mean[YAW])
    }

    /// Covariance of (x m, y m, yaw rad).
    pub(super) fn pose_covariance(&self) -> Matrix3<f64> {
        self.covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    /// Fraction by which odometry's distances are too long, and its sigma.
    pub(super) fn scale(&self) -> (f64, f64) {
        (self.mean[SCALE], self.covariance[(SCALE, SCALE)].sqrt())
    }

    /// What odometry's yaw rate is too large by, and its sigma, radians per second.
    pub(super) fn yaw_rate_radps(&self) -> (f64, f64) {
        (self.mean[YAW_RATE], self.covariance[(YAW_RATE, YAW_RATE)].sqrt())
    }

    fn is_sound(&self) -> bool {
        let variance = self.covariance.diagonal();
        let vague =
            variance[0].max(variance[1]) > MAX_SIGMA_M.powi(2) || variance[YAW] > MAX_SIGMA_RAD.powi(2);
        !vague && self.mean.iter().chain(self.covariance.iter()).all(|v| v.is_finite())
    }
}

fn symmetric(m: &Covariance) -> Covariance {
    0.5 * (m + m.transpose())
}

#[cfg(test)]
mod tests;
