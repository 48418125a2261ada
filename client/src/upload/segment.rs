//! The gate on the segments of a drive.

use echofix_core::convention::Inspection;
use echofix_core::drive::GeoPose;
use echofix_core::gate::{Dropped, gate_scan};
use echofix_core::geo::{self, Grid};
use echofix_core::odometry::{BodyVelocity, Trajectory};
use echofix_core::scan::{Mount, Scan};

use super::config::RecorderConfig;

/// The detections within a segment that can be mapped, on the ground; the inspection sees all of them. `odometry`, where it covers a scan, gives the velocity
/// more accurately than the poses' differences do.
pub(super) fn gated(
    segment: &[GeoPose],
    scans: &[Scan],
    mounts: &[Mount],
    odometry: &Trajectory,
    config: &RecorderConfig,
    dropped: &mut Dropped,
    inspection: &mut Inspection,
) -> Vec<Scan> {
    let way = on_the_grid(segment).unwrap_or_default();
    let velocity = |time_us: i64| -> Option<BodyVelocity> {
        way.at(time_us)?;
        // A hole in the odometry is a hole.
        let gap_us = (config.max_pose_gap_s * 1e6) as i64;
        odometry.velocity_within(time_us, gap_us).or_else(|| way.velocity_at(time_us))
    };
    let mut gated = scans.to_vec();
    for scan in &mut gated {
        let velocity = velocity(scan.time_us);
        if let Some(velocity) = velocity {
            inspection.see(&(&*scan).into(), &mounts[scan.sensor], velocity);
        }
        dropped.add(&gate_scan(scan, &mounts[scan.sensor], velocity, &config.gate));
    }
    gated.retain(|scan| !scan.is_empty());
    gated
}

/// The segment in metres of the grid; close enough to ground metres for a velocity.
fn on_the_grid(segment: &[GeoPose]) -> Option<Trajectory> {
    let grid = Grid::of(segment.first()?.at).ok()?;
    let poses: Result<Vec<_>, geo::Error> =
        segment.iter().map(|p| Ok((p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad)?))).collect();
    Trajectory::new(poses.ok()?).ok()
}
