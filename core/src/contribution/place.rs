//! Scans and poses become hits by tile and cell.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use crate::batch::{self, Dropped};
use crate::drive::GeoPose;
use crate::evidence::{Contribution, Gathering};
use crate::geo::{self, Grid, Zone};
use crate::odometry::{self, Trajectory};
use crate::scan::{Mount, Scan};

use super::Limits;
use super::stretch::{Stretch, cut};

/// A stretch of a drive as it was uploaded, its columns sound.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Submission {
    /// The radars.
    pub mounts: Vec<Mount>,
    /// Its parts.
    pub chunks: Vec<Chunk>,
}

/// A part of an upload: scans, and the poses that cover them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Chunk {
    /// Poses of the body, oldest first.
    pub poses: Vec<GeoPose>,
    /// Scans.
    pub scans: Vec<Scan>,
}

/// What an upload comes to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contributed {
    /// What the map learns.
    pub contribution: Contribution,
    /// Detections left out.
    pub dropped: Dropped,
}

/// Why an upload cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
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
    /// UTM does not reach there.
    #[error(transparent)]
    Outside(#[from] geo::Error),
    /// The way is too long for one upload.
    #[error("the upload touches {tiles} tiles; split it into parts of at most {most}")]
    TooManyTiles {
        /// Tiles touched.
        tiles: usize,
        /// Tiles of one upload, at most.
        most: usize,
    },
    /// A scan names an unknown sensor.
    #[error(transparent)]
    Scans(#[from] batch::Error),
    /// The poses form no trajectory.
    #[error(transparent)]
    Poses(#[from] odometry::Error),
}

/// Places an upload's detections on the map. The scans are put in order of time.
///
/// # Errors
/// When nothing of it counts, or it lies where there is no map.
pub fn contribute(mut submission: Submission, limits: &Limits) -> Result<Contributed, Refusal> {
    let mut placing = Placing::new(limits);
    for chunk in &mut submission.chunks {
        chunk.scans.sort_by_key(|scan| scan.time_us);
        placing.chunk(&submission.mounts, chunk)?;
    }
    let sent = submission.chunks.iter().flat_map(|chunk| &chunk.scans).map(|scan| scan.len() as u64).sum();
    placing.finish(sent)
}

struct Placing<'a> {
    limits: &'a Limits,
    grids: HashMap<Zone, Grid>,
    gathering: Gathering,
    /// Detections that count.
    detections: u64,
    dropped: Dropped,
    /// Poses that were not known well enough.
    uncertain: usize,
}

impl<'a> Placing<'a> {
    fn new(limits: &'a Limits) -> Self {
        Self {
            limits,
            grids: HashMap::new(),
            gathering: Gathering::default(),
            detections: 0,
            dropped: Dropped::default(),
            uncertain: 0,
        }
    }

    fn chunk(&mut self, mounts: &[Mount], chunk: &Chunk) -> Result<(), Refusal> {
        let cut = cut(&chunk.poses, self.limits)?;
        self.uncertain += cut.uncertain;
        let mut scans = &chunk.scans[..];
        for stretch in &cut.stretches {
            let [first, .., last] = &stretch.poses[..] else { continue };
            let (before, rest) = scans.split_at(scans.partition_point(|scan| scan.time_us < first.time_us));
            let (covered, rest) = rest.split_at(rest.partition_point(|scan| scan.time_us <= last.time_us));
            self.dropped.without_pose += detections(before);
            self.stretch(stretch, covered, mounts)?;
            scans = rest;
        }
        self.dropped.without_pose += detections(scans);
        Ok(())
    }

    /// Lays a stretch out in its own zone and in those whose border is near. The same detections
    /// are counted once.
    fn stretch(&mut self, stretch: &Stretch, scans: &[Scan], mounts: &[Mount]) -> Result<(), Refusal> {
        for (rank, zone) in stretch.zones.iter().enumerate() {
            let grid = match self.grids.entry(*zone) {
                Entry::Occupied(grid) => grid.into_mut(),
                Entry::Vacant(place) => place.insert(Grid::new(*zone)?),
            };
            let poses =
                stretch.poses.iter().map(|p| Ok((p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad)?)));
            let poses = Trajectory::new(poses.collect::<Result<Vec<_>, geo::Error>>()?)?;
            let scale = grid.scale_factor(stretch.poses[stretch.poses.len() / 2].at)?;
            let gate = &self.limits.gate;
            let (placed, dropped) = self.gathering.add(*zone, scans, mounts, &poses, scale, gate)?;
            if rank == 0 {
                self.detections += placed;
                self.dropped.add(&dropped);
            }
            let (tiles, most) = (self.gathering.tiles(), self.limits.max_tiles);
            if tiles > most {
                return Err(Refusal::TooManyTiles { tiles, most });
            }
        }
        Ok(())
    }

    /// Something must count; if nothing does, the main reason is told.
    fn finish(self, sent: u64) -> Result<Contributed, Refusal> {
        let Self { limits, gathering, detections, dropped, uncertain, .. } = self;
        if detections > 0 {
            return Ok(Contributed { contribution: gathering.finish(detections), dropped });
        }
        let Dropped { too_slow, too_far, moving, without_pose } = dropped;
        let main = too_slow.max(too_far).max(moving).max(without_pose);
        Err(if main > 0 && main == without_pose && uncertain > 0 {
            let (position_m, yaw_deg) = (limits.max_sigma_position_m, limits.max_sigma_yaw_rad.to_degrees());
            Refusal::PoseTooUncertain { position_m, yaw_deg }
        } else if main > 0 && main == too_slow {
            Refusal::TooSlow { min_speed_mps: limits.gate.min_speed_mps }
        } else {
            Refusal::NoDetections { sent }
        })
    }
}

fn detections(scans: &[Scan]) -> u64 {
    scans.iter().map(|scan| scan.len() as u64).sum()
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
