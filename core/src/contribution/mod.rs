//! From scans and poses to a contribution: which detections count, and where they fall.
//!
//! - [`contribute`]: a submission's detections become hits by tile and cell, near a zone border in every zone
//!   whose map holds the place.
//! - [`Limits`]: what counts.

mod place;
mod stretch;

pub use place::{Chunk, Contributed, Refusal, Submission, contribute};

use crate::scan::Gate;

/// What poses and detections must fulfil to be mapped from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Which detections count.
    pub gate: Gate,
    /// Poses with a larger one-sigma error of the position are not mapped from, metres.
    pub max_sigma_position_m: f64,
    /// Poses with a larger one-sigma error of the heading are not mapped from, radians.
    pub max_sigma_yaw_rad: f64,
    /// Poses farther apart in time are not interpolated between, seconds.
    pub max_pose_gap_s: f64,
    /// Faster motion between two poses is a jump, metres per second.
    pub max_speed_mps: f64,
    /// Tiles of one submission, at most.
    pub max_tiles: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            gate: Gate::default(),
            max_sigma_position_m: 0.3,
            max_sigma_yaw_rad: 0.5_f64.to_radians(),
            max_pose_gap_s: 1.0,
            max_speed_mps: 70.0,
            max_tiles: 4_096,
        }
    }
}
