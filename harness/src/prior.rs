//! Rough poses, drawn around a pose that is known.

use echofix_core::pose::Pose2;
use echofix_sim::rng::normal;
use rand_chacha::ChaCha8Rng;

/// One-sigma error of a rough pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorSigma {
    /// Of the position along each axis, metres.
    pub position_m: f64,
    /// Of the heading, radians.
    pub yaw_rad: f64,
}

impl PriorSigma {
    /// The paper's priors (Sec. "Test procedure"): 2 m and 3 degrees.
    pub const PAPER: Self = Self { position_m: 2.0, yaw_rad: 3_f64.to_radians() };

    /// A pose with an error drawn from this sigma: metres and radians of the pose's own frame.
    pub fn drawn_around(&self, pose: &Pose2, rng: &mut ChaCha8Rng) -> Pose2 {
        Pose2::new(
            pose.x_m + normal(rng, self.position_m),
            pose.y_m + normal(rng, self.position_m),
            pose.yaw_rad + normal(rng, self.yaw_rad),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// Catches: a sigma applied twice, or the heading's in degrees.
    #[test]
    fn priors_err_by_their_sigmas() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let drawn: Vec<_> =
            (0..4000).map(|_| PriorSigma::PAPER.drawn_around(&Pose2::IDENTITY, &mut rng)).collect();
        let rms = |of: fn(&Pose2) -> f64| {
            (drawn.iter().map(|pose| of(pose).powi(2)).sum::<f64>() / drawn.len() as f64).sqrt()
        };
        assert!((rms(|p| p.x_m) - 2.0).abs() < 0.1 && (rms(|p| p.y_m) - 2.0).abs() < 0.1);
        assert!((rms(|p| p.yaw_rad.to_degrees()) - 3.0).abs() < 0.15);
    }
}
