//! Around which pose to search, and how.

use std::f64::consts::{PI, TAU};

use super::drift::DriftPrior;
use crate::gate::MAX_RANGE_M;
use crate::pose::{Pose2, wrap_angle};

/// How to search. The defaults are the paper's (Sec. "Test procedure").
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    /// The search covers this many sigmas of the prior in every direction.
    pub sigmas: f64,
    /// Step of the heading, radians. The step of the position is a cell, 0.1 m.
    pub yaw_step_rad: f64,
    /// Detections farther than this from the body at the reference time are left out, metres: the
    /// window reaches no farther. At speed that is much of what the oldest scans saw behind.
    pub extent_m: f64,
    /// Candidates that are refined, at most.
    pub candidates: usize,
    /// Two candidates nearer than this are one, metres.
    pub separation_m: f64,
    /// What odometry may have drifted over a batch, whatever the batch says of its odometry; `None` believes the batch.
    pub drift: Option<DriftPrior>,
}

impl Default for Search {
    fn default() -> Self {
        Self {
            sigmas: 3.0,
            yaw_step_rad: 1_f64.to_radians(),
            extent_m: MAX_RANGE_M,
            candidates: 5,
            separation_m: 1.0,
            drift: None,
        }
    }
}

/// Half width of a search that leaves out no heading but by rounding, radians.
const ALL_HEADINGS_RAD: f64 = 0.95 * PI;

impl Search {
    /// By how much less likely a prior makes a correction than a pose drawn from all of its search, nats; at least 0. The
    /// truth lies near a prior that says the truth of itself, a chance hill anywhere in the search: so much more must
    /// speak for it. 0 where all headings are searched: then the prior is not believed.
    #[must_use]
    pub fn surprise(&self, prior: &Prior, correction: &Pose2) -> f64 {
        if self.sigmas * prior.sigma_yaw_rad > ALL_HEADINGS_RAD {
            return 0.0;
        }
        let (position, yaw) = (prior.sigma_position_m, prior.sigma_yaw_rad);
        let by = [correction.x_m / position, correction.y_m / position, correction.yaw_rad / yaw];
        let gaussian = -0.5 * by.iter().map(|sigmas| sigmas * sigmas).sum::<f64>() - 1.5 * TAU.ln();
        let uniform = -3.0 * (2.0 * self.sigmas).ln();
        (uniform - gaussian).max(0.0)
    }
}

/// A rough pose of the body on the grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Map metres and radians from grid east.
    pub pose: Pose2,
    /// One-sigma error of the position along each axis, metres.
    pub sigma_position_m: f64,
    /// One-sigma error of the heading, radians.
    pub sigma_yaw_rad: f64,
    /// Map metres per ground metre here.
    pub scale: f64,
}

impl Prior {
    /// The pose corrected by metres east and north and radians.
    #[must_use]
    pub fn corrected(&self, by: &Pose2) -> Pose2 {
        Pose2::new(self.pose.x_m + by.x_m, self.pose.y_m + by.y_m, wrap_angle(self.pose.yaw_rad + by.yaw_rad))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a penalty on what honest priors are usually off by, none on the corners of a search, where chance hills are as
    /// frequent as elsewhere, and one on what a search without a prior finds.
    #[test]
    fn a_prior_is_surprised_by_what_lies_far_off_it_for_its_sigmas() {
        let (search, yaw_rad) = (Search::default(), 0.05);
        let prior =
            Prior { pose: Pose2::IDENTITY, sigma_position_m: 2.0, sigma_yaw_rad: yaw_rad, scale: 1.0 };
        let at = |sigmas: f64| Pose2::new(2.0 * sigmas, -2.0 * sigmas, yaw_rad * sigmas);
        let surprise = |sigmas| search.surprise(&prior, &at(sigmas));
        assert!(surprise(0.0) == 0.0 && surprise(1.3) == 0.0, "{}", surprise(1.3));
        // 3 * 9 / 2 - 3 ln 6 + 1.5 ln 2 pi
        assert!((surprise(3.0) - 10.881).abs() < 1e-3, "{}", surprise(3.0));
        let lost = Prior { sigma_yaw_rad: PI / 3.0, ..prior };
        assert!(search.surprise(&lost, &Pose2::new(6.0, 6.0, 3.0)) <= 0.0);
    }
}
