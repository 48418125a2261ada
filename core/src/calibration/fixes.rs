//! Clock and lever arm from fixes against odometry: for radars without radial speeds.
//!
//! Where stamps come late by `t`, a fix says where the body was `t` ago: it lies behind by the speed times `t`, and is
//! turned back by the yaw rate times `t`. Where the radars sit farther forward than is declared, a fix lies as far ahead of
//! the body. From one fix to the next odometry says what should have changed; what changed otherwise, as the speed and the
//! heading changed, shows both. No pose from outside is needed.

use nalgebra::{SMatrix, SVector, Vector3};

use super::equation::ScanEquations;
use super::evidence::Evidence;
use super::solution::SIZE;
use super::{CalibrationConfig, CalibrationSigma, Estimated};
use crate::odometry::BodyVelocity;
use crate::pose::Pose2;

/// A fix with odometry at its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixSeen {
    /// Microseconds since the Unix epoch.
    pub time_us: i64,
    /// The fix, in ground metres of any frame that stays the same.
    pub fix: Pose2,
    /// One-sigma error of its position along each axis, metres.
    pub sigma_position_m: f64,
    /// One-sigma error of its heading, radians.
    pub sigma_yaw_rad: f64,
    /// The body in odometry's frame.
    pub odometry: Pose2,
    /// The body's velocity.
    pub velocity: BodyVelocity,
}

/// Clock and lever arm that all radars share, from fixes.
#[derive(Debug, Clone)]
pub struct FixCalibration {
    evidence: Evidence,
    floors: CalibrationSigma,
    last: Option<FixSeen>,
}

/// What fixes say of the radars together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedCalibration {
    /// Seconds by which stamps come after the moments they show.
    pub late_s: Estimated,
    /// By how much the radars sit farther forward than declared, metres.
    pub forward_m: Estimated,
    /// By how much they sit farther left, metres.
    pub left_m: Estimated,
}

/// Fixes farther apart say more of odometry's drift than of the clock, microseconds.
const LONGEST_US: i64 = 3_500_000;
/// What odometry errs over a step beside its scale: metres and radians.
const STEP_M: f64 = 0.02;
const STEP_RAD: f64 = 1e-3;

impl FixCalibration {
    /// No fix yet. Of the configuration the prior and the floors count, and the stretches.
    #[must_use]
    pub fn new(config: &CalibrationConfig) -> Self {
        let evidence = Evidence::new(&CalibrationConfig { alike: 1.0, ..*config });
        Self { evidence, floors: config.floors, last: None }
    }

    /// Takes the next fix.
    pub fn add(&mut self, now: FixSeen) {
        if let Some(last) = self.last.replace(now)
            && (1..=LONGEST_US).contains(&(now.time_us - last.time_us))
            && let Some(equations) = equations(&last, &now)
        {
            self.evidence.add(now.time_us, &equations);
        }
    }

    /// What the fixes say; `None` before two of them.
    #[must_use]
    pub fn shared(&self) -> Option<SharedCalibration> {
        (self.evidence.scans() > 0).then(|| {
            let (solution, covariance) = (self.evidence.solved(), self.evidence.covariance());
            let number = |i: usize, floor: f64| Estimated {
                value: solution.0[i],
                sigma: covariance[(i, i)].max(0.0).sqrt().hypot(floor),
            };
            let CalibrationSigma { late_s, forward_m, left_m, .. } = self.floors;
            SharedCalibration {
                late_s: number(0, late_s),
                forward_m: number(2, forward_m),
                left_m: number(3, left_m),
            }
        })
    }
}

/// The error of a fix in the body's frame (metres, radians), by (late, yaw, forward, left, scale, drift of the gyro).
fn error_of(velocity: &BodyVelocity) -> SMatrix<f64, 3, SIZE> {
    let mut error = SMatrix::zeros();
    error[(0, 0)] = -velocity.forward_mps;
    error[(1, 0)] = -velocity.left_mps;
    error[(2, 0)] = -velocity.yaw_rate_radps;
    error[(0, 2)] = 1.0;
    error[(1, 3)] = 1.0;
    error
}

/// The equations of one step between two fixes.
fn equations(last: &FixSeen, now: &FixSeen) -> Option<ScanEquations> {
    let step = last.odometry.between(&now.odometry);
    // The step by the fixes as seen from where odometry says it ended.
    let off = step.between(&last.fix.between(&now.fix));
    let measured = Vector3::new(off.x_m, off.y_m, off.yaw_rad);
    // An error at the start, carried to the end of the step.
    let (s, c) = step.yaw_rad.sin_cos();
    let carried = SMatrix::<f64, 3, 3>::new(
        c,
        s,
        s * step.x_m - c * step.y_m,
        -s,
        c,
        c * step.x_m + s * step.y_m,
        0.0,
        0.0,
        1.0,
    );
    let mut slope = error_of(&now.velocity) - carried * error_of(&last.velocity);
    let seconds = (now.time_us - last.time_us) as f64 * 1e-6;
    let [along, across] = [c * step.x_m + s * step.y_m, c * step.y_m - s * step.x_m];
    slope[(0, 4)] = -along;
    slope[(1, 4)] = -across;
    slope[(1, 5)] = -0.5 * seconds * along;
    slope[(2, 5)] = -seconds;
    let variance = |a: f64, b: f64, step: f64| a * a + b * b + step * step;
    let position = variance(last.sigma_position_m, now.sigma_position_m, STEP_M);
    let yaw = variance(last.sigma_yaw_rad, now.sigma_yaw_rad, STEP_RAD);
    let weight =
        SMatrix::<f64, 3, 3>::from_diagonal(&SVector::from([position, position, yaw]).map(f64::recip));
    let sane = measured.iter().all(|v| v.is_finite()) && position.is_finite() && yaw.is_finite();
    // Beyond that a fix was wrong, or odometry jumped.
    let near = off.x_m.hypot(off.y_m) < 2.0 && off.yaw_rad.abs() < 0.2;
    (sane && near).then(|| ScanEquations {
        information: slope.transpose() * weight * slope,
        sum: slope.transpose() * weight * measured,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Five minutes of stops, starts and turns, a fix a second with 5 cm and 0.1 degrees of noise, behind by `late_s`
    /// and ahead by `forward_m`.
    fn seen(late_s: f64, forward_m: f64, seed: u64) -> SharedCalibration {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut noise = |sigma: f64| sigma * 1.73 * rng.random_range(-1.0..1.0);
        let speed = |t: f64| 7.0 + 6.0 * (0.4 * t).sin();
        let turn = |t: f64| 0.3 * (0.23 * t).sin();
        let mut way = vec![Pose2::IDENTITY];
        for i in 0..30_200 {
            let t = (f64::from(i) + 0.5) * 0.01;
            way.push(way[i as usize].compose(&Pose2::new(0.01 * speed(t), 0.0, 0.01 * turn(t))));
        }
        let mut calibration = FixCalibration::new(&CalibrationConfig::default());
        for second in 1..300_usize {
            let t = second as f64;
            let shown = &way[100 * second - (100.0 * late_s) as usize];
            let error = Pose2::new(forward_m + noise(0.05), noise(0.05), noise(0.0017));
            let velocity = BodyVelocity { forward_mps: speed(t), left_mps: 0.0, yaw_rate_radps: turn(t) };
            calibration.add(FixSeen {
                time_us: second as i64 * 1_000_000,
                fix: shown.compose(&error),
                sigma_position_m: 0.05,
                sigma_yaw_rad: 0.0017,
                odometry: way[100 * second],
                velocity,
            });
        }
        calibration.shared().unwrap()
    }

    /// Catches: a wrong sign of clock or lever arm, and sigmas that do not hold.
    #[test]
    fn fixes_show_a_late_clock_and_a_shifted_radar() {
        let mut nees = [0.0; 2];
        for seed in 0..20 {
            let found = seen(0.05, 0.1, seed);
            assert!((found.late_s.value - 0.05).abs() < 0.01, "{found:?}");
            assert!((found.forward_m.value - 0.1).abs() < 0.06, "{found:?}");
            nees[0] += ((found.late_s.value - 0.05) / found.late_s.sigma).powi(2) / 20.0;
            nees[1] += ((found.forward_m.value - 0.1) / found.forward_m.sigma).powi(2) / 20.0;
        }
        // Steps that follow each other share a fix, which is not made use of: the sigmas are three times too large.
        assert!(nees.iter().all(|n| (0.05..2.5).contains(n)), "{nees:?}");
    }
}
