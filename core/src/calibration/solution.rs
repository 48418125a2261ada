//! What is estimated of one radar.

use nalgebra::SVector;

use super::CalibrationSigma;
use crate::pose::wrap_angle;
use crate::scan::Mount;

/// Numbers that are estimated for each radar.
pub const SIZE: usize = 6;

pub(super) type Vector = SVector<f64, SIZE>;

/// (late s, yaw rad, forward m, left m, scale of the speed, scale of the azimuth), on top of what was built.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Solution(pub Vector);

impl Solution {
    /// Seconds by which the clock is late.
    #[must_use]
    pub fn late_s(&self) -> f64 {
        self.0[0]
    }

    /// The mount with its turn and shift.
    #[must_use]
    pub fn mount(&self, built: &Mount) -> Mount {
        Mount::new(built.x_m + self.0[2], built.y_m + self.0[3], wrap_angle(built.yaw_rad + self.0[1]))
    }

    /// Scales of speed and azimuth, as what they differ from 1 by.
    #[must_use]
    pub fn scales(&self) -> [f64; 2] {
        [self.0[4], self.0[5]]
    }

    /// Within one sigma of the prior: nothing is made linear farther off.
    #[must_use]
    pub fn clamped(&self, prior: &CalibrationSigma) -> Self {
        let most = prior_sigmas(prior);
        Self(Vector::from_fn(|i, _| self.0[i].clamp(-most[i], most[i])))
    }
}

/// One-sigma errors of the scales: of wheels and tyres, and of an antenna.
const SCALES: [f64; 2] = [0.02, 0.02];

pub(super) fn prior_sigmas(prior: &CalibrationSigma) -> [f64; SIZE] {
    [prior.late_s, prior.yaw_rad, prior.forward_m, prior.left_m, SCALES[0], SCALES[1]]
}
