//! A raw upload becomes an evidence delta.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use crate::convention::{Finding, Inspection, inspect_onto};
use crate::datum::PoseSigma;
use crate::drive::GeoPose;
use crate::drive::segment::{DriveSegment, split_segments};
use crate::evidence::{EvidenceAccumulator, EvidenceDelta};
use crate::gate::{self, Dropped};
use crate::geo::{self, Grid, Zone};
use crate::odometry::{self, Trajectory};
use crate::scan::slices::sliced;
use crate::scan::{Mount, Scan};

use super::EvidenceLimits;

/// Scans and poses as a vehicle uploads them, their columns validated.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RawUpload {
    /// The radars that the scans name.
    pub mounts: Vec<Mount>,
    /// The scans and poses, in chunks.
    pub chunks: Vec<Chunk>,
}

/// A part of a raw upload: scans, and the poses that cover them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Chunk {
    /// Poses of the body, oldest first.
    pub poses: Vec<GeoPose>,
    /// Scans, in any order.
    pub scans: Vec<Scan>,
}

/// The evidence of one upload, and what was left out of it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BuiltEvidence {
    /// What the upload adds to the map.
    pub delta: EvidenceDelta,
    /// Detections that were dropped.
    pub dropped: Dropped,
    /// How well the poses are known that it was mapped from: the largest sigmas among them.
    pub sigma: PoseSigma,
}

/// Why no evidence can be built from an upload.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// No pose is known well enough.
    #[error("the poses are not known well enough to map from: at most {position_m} m and {yaw_deg} degrees")]
    PoseTooUncertain {
        /// Largest one-sigma error of the position that is mapped from, metres.
        position_m: f64,
        /// Largest one-sigma error of the heading that is mapped from, degrees.
        yaw_deg: f64,
    },
    /// All scans were taken near standstill.
    #[error("the scans were taken below {min_speed_mps} m/s, where clutter dominates")]
    TooSlow {
        /// The slowest speed mapped from, metres per second.
        min_speed_mps: f64,
    },
    /// Nothing is left to map.
    #[error("none of {sent} detections is left to map")]
    NoDetections {
        /// Detections in the upload.
        sent: u64,
    },
    /// Most of what was seen seems to move.
    #[error("{0}")]
    MostlyMoving(Finding),
    /// Something is in another convention than the contract's.
    #[error("{0}")]
    WrongConvention(Finding),
    /// UTM does not reach there.
    #[error(transparent)]
    Outside(#[from] geo::Error),
    /// The way is too long for one upload.
    #[error("the upload touches {tiles} tiles; split it into parts of at most {most}")]
    TooManyTiles {
        /// Tiles that the upload touches.
        tiles: usize,
        /// Tiles of one upload, at most.
        most: usize,
    },
    /// A scan names an unknown sensor.
    #[error(transparent)]
    Scans(#[from] gate::UnknownSensor),
    /// The poses form no trajectory.
    #[error(transparent)]
    Poses(#[from] odometry::Error),
}

/// Builds the evidence of an upload: projects its detections onto the map. The scans are sorted by time, those that took
/// their time as their [`slices`](crate::scan::slices).
///
/// # Errors
/// When none of its detections count or more of them move than stand, when something is in another convention than the contract's, or when it
/// lies where there is no map.
pub fn build_evidence(mut upload: RawUpload, limits: &EvidenceLimits) -> Result<BuiltEvidence, BuildError> {
    let mut builder = DeltaBuilder::new(limits);
    for chunk in &mut upload.chunks {
        if let Some(slices) = sliced(chunk.scans.iter().map(Into::into)) {
            chunk.scans = slices;
        }
        chunk.scans.sort_by_key(|scan| scan.time_us);
        builder.chunk(&upload.mounts, chunk)?;
    }
    let sent = upload.chunks.iter().flat_map(|chunk| &chunk.scans).map(|scan| scan.len() as u64).sum();
    builder.finish(sent)
}

/// An evidence delta while it is built.
struct DeltaBuilder<'a> {
    limits: &'a EvidenceLimits,
    grids: HashMap<Zone, Grid>,
    accumulator: EvidenceAccumulator,
    /// Detections that count.
    detections: u64,
    dropped: Dropped,
    /// Poses that are not known well enough.
    uncertain: usize,
    /// Looks at poses, and at scans where most seems to move.
    inspection: Inspection,
    /// The largest sigmas of those that are.
    sigma: PoseSigma,
}

impl<'a> DeltaBuilder<'a> {
    fn new(limits: &'a EvidenceLimits) -> Self {
        Self {
            limits,
            grids: HashMap::new(),
            accumulator: EvidenceAccumulator::default(),
            detections: 0,
            dropped: Dropped::default(),
            uncertain: 0,
            inspection: Inspection::default(),
            sigma: PoseSigma::default(),
        }
    }

    fn chunk(&mut self, mounts: &[Mount], chunk: &Chunk) -> Result<(), BuildError> {
        let limits = &self.limits.segments;
        self.uncertain += chunk.poses.iter().filter(|pose| !limits.allows(pose)).count();
        chunk.poses.iter().filter(|pose| limits.allows(pose)).for_each(|pose| self.inspection.pass(pose));
        let mut scans = &chunk.scans[..];
        for segment in &split_segments(&chunk.poses, limits)? {
            let [first, .., last] = segment.poses else { continue };
            let (before, rest) = scans.split_at(scans.partition_point(|scan| scan.time_us < first.time_us));
            let (covered, rest) = rest.split_at(rest.partition_point(|scan| scan.time_us <= last.time_us));
            self.dropped.without_pose += detections(before);
            self.segment(segment, covered, mounts)?;
            for pose in segment.poses.iter().filter(|_| !covered.is_empty()) {
                let sigma = PoseSigma::declared(pose.sigma_position_m, pose.sigma_yaw_rad);
                self.sigma = self.sigma.larger(sigma);
            }
            scans = rest;
        }
        self.dropped.without_pose += detections(scans);
        Ok(())
    }

    /// Projects a segment into its own zone and into those whose border is near. The same detections
    /// are counted once.
    fn segment(
        &mut self,
        segment: &DriveSegment<'_>,
        scans: &[Scan],
        mounts: &[Mount],
    ) -> Result<(), BuildError> {
        for (rank, zone) in segment.zones.iter().enumerate() {
            let grid = match self.grids.entry(*zone) {
                Entry::Occupied(grid) => grid.into_mut(),
                Entry::Vacant(entry) => entry.insert(Grid::new(*zone)?),
            };
            let poses =
                segment.poses.iter().map(|p| Ok((p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad)?)));
            let poses = Trajectory::new(poses.collect::<Result<Vec<_>, geo::Error>>()?)?;
            let scale = grid.scale_factor(segment.poses[segment.poses.len() / 2].at)?;
            let gate = &self.limits.gate;
            let (counted, dropped) = self.accumulator.add(*zone, scans, mounts, &poses, scale, gate)?;
            if rank == 0 {
                self.detections += counted;
                self.dropped.add(&dropped);
                if dropped.moving > counted {
                    inspect_onto(&mut self.inspection, scans, mounts, &poses);
                }
            }
            let (tiles, most) = (self.accumulator.tiles(), self.limits.max_tiles);
            if tiles > most {
                return Err(BuildError::TooManyTiles { tiles, most });
            }
        }
        Ok(())
    }

    /// The delta; where no detection counts, the main reason.
    fn finish(self, sent: u64) -> Result<BuiltEvidence, BuildError> {
        let Self { limits, accumulator, detections, dropped, uncertain, inspection, sigma, .. } = self;
        if let Some(finding) = inspection.mostly_moving(dropped.moving, detections) {
            return Err(BuildError::MostlyMoving(finding));
        }
        let wrong = |finding: &Finding| !matches!(finding, Finding::Moving { .. });
        if let Some(finding) = inspection.findings().into_iter().find(wrong) {
            return Err(BuildError::WrongConvention(finding));
        }
        if detections > 0 {
            return Ok(BuiltEvidence { delta: accumulator.finish(detections), dropped, sigma });
        }
        let Dropped { too_slow, too_far, off_height, moving, without_pose } = dropped;
        let main = too_slow.max(too_far).max(off_height).max(moving).max(without_pose);
        Err(if main > 0 && main == without_pose && uncertain > 0 {
            let position_m = limits.segments.max_sigma_position_m;
            let yaw_deg = limits.segments.max_sigma_yaw_rad.to_degrees();
            BuildError::PoseTooUncertain { position_m, yaw_deg }
        } else if main > 0 && main == too_slow {
            BuildError::TooSlow { min_speed_mps: limits.gate.min_speed_mps }
        } else {
            BuildError::NoDetections { sent }
        })
    }
}

fn detections(scans: &[Scan]) -> u64 {
    scans.iter().map(|scan| scan.len() as u64).sum()
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
