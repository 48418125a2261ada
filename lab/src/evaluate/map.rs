//! A radar map in memory, without a service.

use std::collections::BTreeMap;

use anyhow::Context;
use echofix_core::datum::{Offset, PoseSigma};
use echofix_core::drive::segment::{SegmentLimits, usable_segments};
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::evidence::{EvidenceAccumulator, Pass};
use echofix_core::gate::{Gate, gate_scan};
use echofix_core::geo::{Grid, TileId, Zone};
use echofix_core::odometry;
use echofix_core::odometry::Trajectory;
use echofix_core::scan::Scan;
use echofix_core::tile::{Ledger, Tile};
use echofix_core::time::DAY_US;
use echofix_core::window::{EvidenceWindow, MapSquare};

/// Longest gap between reference poses that is interpolated, seconds.
const MAX_POSE_GAP_S: f64 = 0.5;

/// Whether detections that move, by their radial speed, are part of maps and batches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Movers {
    /// They are: the paper has no gate for them.
    Included,
    /// They are dropped.
    Excluded,
}

impl Movers {
    /// The paper's gates for speed and range, with or without one for movers.
    pub fn gate(self) -> Gate {
        match self {
            Self::Excluded => Gate::default(),
            Self::Included => Gate { max_doppler_residual_mps: f64::INFINITY, ..Gate::default() },
        }
    }
}

/// Identifies a map in the caches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct MapKey {
    /// Number of the world.
    pub world: usize,
    /// Number of its contributors.
    pub contributors: usize,
    /// Whether it contains movers.
    pub movers: Movers,
}

/// The tiles of some contributors.
#[derive(Debug, Clone)]
pub struct RadarMap {
    /// Identifies the map in the caches.
    pub key: MapKey,
    zone: Zone,
    tiles: BTreeMap<TileId, Tile>,
}

impl RadarMap {
    /// An empty map.
    pub fn new(key: MapKey, zone: Zone) -> Self {
        Self { key, zone, tiles: BTreeMap::new() }
    }

    /// The map of these tiles.
    pub fn of_tiles(key: MapKey, zone: Zone, tiles: BTreeMap<TileId, Tile>) -> Self {
        Self { key, zone, tiles }
    }

    /// Adds all evidence of another map, without decay.
    pub fn join(&mut self, other: &Self) {
        for (id, theirs) in &other.tiles {
            let joined = self.tiles.get(id).map_or_else(|| theirs.clone(), |ours| ours.merged(theirs));
            self.tiles.insert(*id, joined);
        }
    }

    /// The same tiles, as the map of so many contributors.
    #[must_use]
    pub fn grown_from(&self, contributors: usize) -> Self {
        Self { key: MapKey { contributors, ..self.key }, ..self.clone() }
    }

    /// Adds the evidence of a drive from its reference poses, those known to `max_sigma_m` or better.
    ///
    /// # Errors
    /// When the drive has no such pose, or its scans and poses do not fit together.
    pub fn add(&mut self, drive: &Drive, contributor: u64, max_sigma_m: f64) -> anyhow::Result<()> {
        let grid = Grid::new(self.zone)?;
        let scans = gated(drive, self.key.movers);
        let (mut accumulator, mut day) = (EvidenceAccumulator::default(), None);
        let mut sigma = PoseSigma::default();
        for poses in usable_segments(&drive.reference, &mapped_from(max_sigma_m)) {
            let scale = grid.scale_factor(poses[0].at)?;
            let trajectory = on_grid(&grid, poses)?;
            let from = scans.partition_point(|s| s.time_us < poses[0].time_us);
            let to = scans.partition_point(|s| s.time_us <= poses[poses.len() - 1].time_us);
            // Movers are dropped already: odometry shows them better than absolute poses would.
            let gate = Movers::Included.gate();
            accumulator.add(self.zone, &scans[from..to], &drive.mounts, &trajectory, scale, &gate)?;
            sigma = sigma.larger(declared(poses));
            day = day.or(u16::try_from(poses[0].time_us.div_euclid(DAY_US)).ok());
        }
        let day = day.with_context(|| {
            format!(
                "the drive of `{}` has no reference pose known to {max_sigma_m} m to map from",
                drive.vehicle
            )
        })?;
        for (id, evidence) in accumulator.finish(0).tiles {
            // The whole drive is folded at once, so that no ledger is needed.
            let pass = Pass { day, contributor };
            let (tile, ledger) = (self.tiles.entry(id).or_default(), &mut Ledger::default());
            tile.fold_moved(ledger, pass, &evidence, Offset::default(), sigma);
        }
        Ok(())
    }

    /// The evidence in a square.
    pub fn window(&self, square: MapSquare) -> EvidenceWindow {
        EvidenceWindow::stitch(square, square.tiles().filter_map(|id| Some((id, self.tiles.get(&id)?))))
    }

    /// A tile; `None` where the map has none.
    pub fn tile(&self, id: TileId) -> Option<&Tile> {
        self.tiles.get(&id)
    }

    /// The UTM zone of the map.
    pub fn zone(&self) -> Zone {
        self.zone
    }
}

/// The scans of a drive, without movers if `movers` excludes them.
pub fn gated(drive: &Drive, movers: Movers) -> Vec<Scan> {
    let mut scans = drive.scans.clone();
    if movers == Movers::Excluded {
        let limit_mps = movers.gate().max_doppler_residual_mps;
        for scan in &mut scans {
            let velocity = drive.odometry.velocity_at(scan.time_us);
            if let (Some(velocity), Some(mount)) = (velocity, drive.mounts.get(scan.sensor)) {
                gate_scan(scan, mount, Some(velocity), &Gate::of_movers(limit_mps));
            }
        }
    }
    scans
}

/// Geodetic poses as a trajectory on the grid.
///
/// # Errors
/// When a pose is off the grid or the times do not increase.
pub fn on_grid(grid: &Grid, poses: &[GeoPose]) -> anyhow::Result<Trajectory> {
    let mut trajectory = Trajectory::default();
    for pose in poses {
        trajectory.push(pose.time_us, grid.pose_from_geodetic(pose.at, pose.yaw_rad)?)?;
    }
    Ok::<_, odometry::Error>(trajectory).map_err(Into::into)
}

/// What a contributor declares of poses: the largest sigmas among them.
pub fn declared(poses: &[GeoPose]) -> PoseSigma {
    let of = |pose: &GeoPose| PoseSigma::declared(pose.sigma_position_m, pose.sigma_yaw_rad);
    poses.iter().map(of).fold(PoseSigma::default(), PoseSigma::larger)
}

/// Which poses a map is made from: those known to `max_sigma_m` or better, whatever the sigma of their heading.
pub fn mapped_from(max_sigma_m: f64) -> SegmentLimits {
    SegmentLimits {
        max_sigma_position_m: max_sigma_m,
        max_sigma_yaw_rad: f64::INFINITY,
        max_pose_gap_s: MAX_POSE_GAP_S,
        max_speed_mps: f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_end_at_gaps_and_uncertain_poses() {
        let pose = |time_us, sigma_position_m| GeoPose { time_us, sigma_position_m, ..GeoPose::default() };
        let poses = [
            pose(0, 0.1),
            pose(100_000, 0.1),
            pose(200_000, 0.9),
            pose(300_000, 0.1),
            pose(400_000, 0.1),
            pose(2_000_000, 0.1),
            pose(2_100_000, 0.1),
        ];
        let lengths: Vec<_> = usable_segments(&poses, &mapped_from(0.3)).map(<[_]>::len).collect();
        assert_eq!(lengths, [2, 2, 2]);
    }
}
