//! Stretches of a drive whose poses are known well enough to map from.

use echofix_core::batch::Dropped;
use echofix_core::drive::GeoPose;
use echofix_core::geo::{self, Grid};
use echofix_core::odometry::{BodyVelocity, Trajectory};
use echofix_core::scan::{Mount, Scan};

use super::config::Config;
use crate::gate;

/// Splits poses where one is not known well enough or the gap to the next is too long; stretches of
/// a single pose are left out, since nothing can be interpolated on them.
pub(super) fn good<'a>(poses: &'a [GeoPose], config: &Config) -> impl Iterator<Item = &'a [GeoPose]> {
    let max_gap_us = (config.max_pose_gap_s * 1e6) as i64;
    let max_position_m = config.max_sigma_position_m;
    let max_yaw_rad = config.max_sigma_yaw_rad;
    poses
        .split(move |p| p.sigma_position_m > max_position_m || p.sigma_yaw_rad > max_yaw_rad)
        .flat_map(move |run| run.chunk_by(move |a, b| b.time_us - a.time_us <= max_gap_us))
        .filter(|run| run.len() > 1)
}

/// What of the scans within a stretch maps; `odometry`, where it covers a scan, tells the velocity
/// better than the poses' differences do.
pub(super) fn gated(
    stretch: &[GeoPose],
    scans: &[Scan],
    mounts: &[Mount],
    odometry: &Trajectory,
    config: &Config,
    dropped: &mut Dropped,
) -> Vec<Scan> {
    let way = on_the_grid(stretch).unwrap_or_default();
    let velocity = |time_us: i64| -> Option<BodyVelocity> {
        way.at(time_us)?;
        odometry.velocity_at(time_us).or_else(|| way.velocity_at(time_us))
    };
    let mut kept = scans.to_vec();
    for scan in &mut kept {
        let velocity = velocity(scan.time_us);
        gate::apply(scan, &mounts[scan.sensor], velocity, &config.gate, dropped);
    }
    kept.retain(|scan| !scan.is_empty());
    kept
}

/// The stretch in metres of the grid; close enough to ground metres for a velocity.
fn on_the_grid(stretch: &[GeoPose]) -> Option<Trajectory> {
    let grid = Grid::of(stretch.first()?.at).ok()?;
    let poses: Result<Vec<_>, geo::Error> =
        stretch.iter().map(|p| Ok((p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad)?))).collect();
    Trajectory::new(poses.ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubtful_poses_and_gaps_split_a_drive() {
        let pose = |time_ms: i64, sigma_position_m, sigma_yaw_rad| GeoPose {
            time_us: time_ms * 1000,
            sigma_position_m,
            sigma_yaw_rad,
            ..GeoPose::default()
        };
        let poses = [
            pose(0, 0.1, 0.001),
            pose(100, 0.1, 0.001),
            pose(200, 0.9, 0.001), // doubtful position
            pose(300, 0.1, 0.001), // alone
            pose(400, 0.1, 0.1),   // doubtful heading
            pose(500, 0.1, 0.001),
            pose(600, 0.1, 0.001),
            pose(9600, 0.1, 0.001), // after a gap
            pose(9700, 0.1, 0.001),
        ];
        let config = Config::default();
        let lengths: Vec<_> = good(&poses, &config).map(|run| (run[0].time_us / 1000, run.len())).collect();
        assert_eq!(lengths, [(0, 2), (500, 2), (9600, 2)]);
    }
}
