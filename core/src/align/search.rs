//! Around which pose to search, and how.

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
