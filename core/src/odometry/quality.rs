//! How good odometry is over a batch.

/// How odometry errs over the seconds of a batch: one sigma of errors that last (a wheel's scale, a gyro's bias), and
/// that may change by as much from the middle of the batch to its end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryQuality {
    /// Error of the velocity along each axis, metres per second, whatever the speed.
    pub velocity_mps: f64,
    /// The same as a fraction of the speed.
    pub velocity_fraction: f64,
    /// Error of the yaw rate, radians per second.
    pub yaw_rate_radps: f64,
}

impl OdometryQuality {
    /// Nobody's odometry is better, metres per second and radians per second: below this a batch is rigid.
    const LEAST: (f64, f64) = (0.002, 2e-4);

    /// Error of the velocity along each axis at a speed, metres per second; not zero.
    #[must_use]
    pub fn velocity_sigma_mps(&self, speed_mps: f64) -> f64 {
        self.velocity_mps.hypot(self.velocity_fraction * speed_mps).max(Self::LEAST.0)
    }

    /// Error of the yaw rate, radians per second; not zero.
    #[must_use]
    pub fn yaw_rate_sigma_radps(&self) -> f64 {
        self.yaw_rate_radps.max(Self::LEAST.1)
    }

    /// True when every sigma is a number that can be one.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let sigmas = [self.velocity_mps, self.velocity_fraction, self.yaw_rate_radps];
        sigmas.iter().all(|sigma| sigma.is_finite() && *sigma >= 0.0)
    }
}

impl Default for OdometryQuality {
    /// Of odometry that nothing is known of: the paper's largest drift (its Sec. "Sensitivity to Odometric Drift"),
    /// 40 cm and one degree in 5 s. Who is silent and has better odometry gets a less exact answer, not a wrong level.
    fn default() -> Self {
        Self { velocity_mps: 0.08, velocity_fraction: 0.0, yaw_rate_radps: 0.2_f64.to_radians() }
    }
}
