//! From scans and poses to an evidence delta: which detections count, and where they fall.
//!
//! - [`build_evidence`]: a [`RawUpload`]'s detections become hits by tile and cell, near a zone border in
//!   every zone whose map holds the position.
//! - [`EvidenceLimits`]: what counts.

mod upload;

pub use upload::{BuildError, BuiltEvidence, Chunk, RawUpload, build_evidence};

use crate::drive::segment::SegmentLimits;
use crate::gate::Gate;

/// What poses and detections must fulfil to be mapped from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvidenceLimits {
    /// Which detections count.
    pub gate: Gate,
    /// Which poses count.
    pub segments: SegmentLimits,
    /// Tiles of one upload, at most.
    pub max_tiles: usize,
}

impl Default for EvidenceLimits {
    fn default() -> Self {
        Self { gate: Gate::default(), segments: SegmentLimits::default(), max_tiles: 4_096 }
    }
}
