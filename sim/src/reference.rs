//! What a vehicle's positioning believes: the true pose with slowly varying errors.

use echofix_core::pose::Pose2;
use rand_chacha::ChaCha8Rng;

use crate::rng::normal;

/// Errors of the reference pose: each a first-order Gauss-Markov process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseError {
    /// One-sigma error along each axis, ground metres.
    pub sigma_position_m: f64,
    /// One-sigma error of the heading, radians.
    pub sigma_yaw_rad: f64,
    /// Time after which errors have mostly forgotten what they were, seconds.
    pub correlation_s: f64,
}

impl Default for PoseError {
    /// An inertial navigation system with RTK: decimetre accurate (paper, Sec. "Data Collection").
    fn default() -> Self {
        Self { sigma_position_m: 0.1, sigma_yaw_rad: 0.15_f64.to_radians(), correlation_s: 30.0 }
    }
}

impl PoseError {
    /// No error at all.
    pub const NONE: Self = Self { sigma_position_m: 0.0, sigma_yaw_rad: 0.0, correlation_s: 30.0 };
}

/// The errors of one drive, in order of time.
pub(crate) struct Wander {
    params: PoseError,
    rng: ChaCha8Rng,
    now: Option<(i64, [f64; 3])>,
}

impl Wander {
    pub(crate) fn new(params: PoseError, rng: ChaCha8Rng) -> Self {
        Self { params, rng, now: None }
    }

    /// The believed pose at a time, which must not come before the last one.
    pub(crate) fn believe(&mut self, time_us: i64, truth: &Pose2) -> Pose2 {
        let (before, kept) = match self.now {
            None => ([0.0; 3], 0.0),
            Some((last_us, errors)) => {
                (errors, (-((time_us - last_us) as f64) * 1e-6 / self.params.correlation_s).exp())
            }
        };
        let fresh = (1.0 - kept * kept).sqrt();
        let sigma = [self.params.sigma_position_m, self.params.sigma_position_m, self.params.sigma_yaw_rad];
        let errors = [0, 1, 2].map(|i| kept * before[i] + normal(&mut self.rng, fresh * sigma[i]));
        self.now = Some((time_us, errors));
        Pose2::new(truth.x_m + errors[0], truth.y_m + errors[1], truth.yaw_rad + errors[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, stream};

    #[test]
    fn errors_have_the_size_and_the_memory_asked_for() {
        let mut wander = Wander::new(PoseError::default(), stream(3, Purpose::Reference, 0, 0));
        let errors: Vec<f64> =
            (0..60_000).map(|k| wander.believe(k * 1_000_000, &Pose2::IDENTITY).x_m).collect();
        let moment = |lag: usize| {
            let products = errors.iter().zip(&errors[lag..]).map(|(a, b)| a * b);
            products.sum::<f64>() / (errors.len() - lag) as f64
        };
        assert!((moment(0).sqrt() - 0.1).abs() < 0.01, "{}", moment(0).sqrt());
        assert!((moment(30) / moment(0) - (-1.0_f64).exp()).abs() < 0.08);
    }
}
