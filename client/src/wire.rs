//! From the values of [`echofix_core`] to the columns of the contract, and a tile's id back.
//!
//! Times on the wire are offsets from the enclosing message's reference time, so that they pack
//! into few bytes.

use echofix_core::convention::{Convention, Finding};
use echofix_core::drive::GeoPose;
use echofix_core::gate::Dropped;
use echofix_core::geo::{TileId, Zone};
use echofix_core::odometry::OdometryQuality;
use echofix_core::own_error::MountSigma;
use echofix_core::pose::Pose2;
use echofix_core::scan::{Mount, Scan};
use echofix_proto::v1;

/// A tile's id out of its message; `None` of a zone that is none.
pub(crate) fn tile_id(message: &v1::TileId) -> Option<TileId> {
    Some(TileId { zone: Zone::from_epsg(message.epsg).ok()?, x: message.x, y: message.y })
}

/// A mount as a message; metres and radians become `f32`.
#[must_use]
pub fn mount(mount: &Mount) -> v1::SensorMount {
    v1::SensorMount {
        x_m: mount.x_m as f32,
        y_m: mount.y_m as f32,
        yaw_rad: mount.yaw_rad as f32,
        ..v1::SensorMount::default()
    }
}

/// The same, with how well the mount and the radar's clock are known.
#[must_use]
pub fn known_mount(mount: &Mount, sigma: &MountSigma) -> v1::SensorMount {
    v1::SensorMount {
        sigma_time_s: Some(sigma.time_s as f32),
        sigma_position_m: Some(sigma.position_m as f32),
        sigma_yaw_rad: Some(sigma.yaw_rad as f32),
        ..self::mount(mount)
    }
}

/// The geometry of scans, oldest first, as columns relative to `reference_time_us`: eight bytes a detection, and
/// more where scans still have elevations or times of their detections, which gated ones do not.
/// Movers are dropped on the vehicle, so radial speeds are not sent, nor are cross sections.
#[must_use]
pub fn scans<'a>(
    scans: impl IntoIterator<Item = &'a Scan, IntoIter: Clone>,
    reference_time_us: i64,
) -> v1::Scans {
    let scans = scans.into_iter();
    v1::Scans {
        sensor: scans.clone().map(|s| s.sensor as u32).collect(),
        time_offset_us: scans.clone().map(|s| s.time_us.saturating_sub(reference_time_us)).collect(),
        detection_count: scans.clone().map(|s| s.len() as u32).collect(),
        range_m: scans.clone().flat_map(|s| &s.range_m).copied().collect(),
        azimuth_rad: scans.clone().flat_map(|s| &s.azimuth_rad).copied().collect(),
        elevation_rad: optional(scans.clone(), |s| &s.elevation_rad),
        detection_time_offset_us: optional(scans, |s| &s.detection_time_offset_us),
        ..v1::Scans::default()
    }
}

/// A column that some scans have: 0 for the others, as if they lay in the plane and were taken at once.
fn optional<'a, T: Copy + Default + 'a>(
    scans: impl Iterator<Item = &'a Scan> + Clone,
    column: impl Fn(&'a Scan) -> &'a Vec<T>,
) -> Vec<T> {
    if scans.clone().all(|scan| column(scan).is_empty()) {
        return Vec::new();
    }
    let rows = |scan: &'a Scan| (0..scan.len()).map(move |row| (scan, row));
    scans.flat_map(rows).map(|(scan, row)| column(scan).get(row).copied().unwrap_or_default()).collect()
}

/// What the gates left out.
#[must_use]
pub fn dropped(dropped: &Dropped) -> v1::DroppedDetections {
    let Dropped { too_slow, too_far, off_height, moving, without_pose } = *dropped;
    v1::DroppedDetections { too_slow, too_far, moving, without_pose, off_height }
}

/// The conventions that findings suspect, each once.
#[must_use]
pub fn suspected(findings: &[Finding]) -> Vec<i32> {
    let mut codes: Vec<i32> =
        findings.iter().flat_map(Finding::suspects).map(|suspect| convention(*suspect).into()).collect();
    codes.sort_unstable();
    codes.dedup();
    codes
}

fn convention(suspect: Convention) -> v1::Convention {
    match suspect {
        Convention::RadialSpeedTowards => v1::Convention::RadialSpeedTowards,
        Convention::RadialSpeedCompensated => v1::Convention::RadialSpeedCompensated,
        Convention::RadialSpeedKmh => v1::Convention::RadialSpeedKmh,
        Convention::AzimuthClockwise => v1::Convention::AzimuthClockwise,
        Convention::AzimuthDegrees => v1::Convention::AzimuthDegrees,
        Convention::YawFromNorth => v1::Convention::YawFromNorth,
        Convention::YawFromNorthCounterClockwise => v1::Convention::YawFromNorthCounterClockwise,
        Convention::YawClockwise => v1::Convention::YawClockwise,
        Convention::YawDegrees => v1::Convention::YawDegrees,
        Convention::LatLonSwapped => v1::Convention::LatLonSwapped,
    }
}

/// A trajectory as columns relative to `reference_time_us`.
pub fn odometry(poses: impl IntoIterator<Item = (i64, Pose2)>, reference_time_us: i64) -> v1::Odometry {
    let mut message = v1::Odometry::default();
    for (time_us, pose) in poses {
        message.time_offset_us.push(time_us.saturating_sub(reference_time_us));
        message.x_m.push(pose.x_m);
        message.y_m.push(pose.y_m);
        message.yaw_rad.push(pose.yaw_rad);
    }
    message
}

/// The same, with how good the odometry is.
#[must_use]
pub fn known_odometry(
    poses: impl IntoIterator<Item = (i64, Pose2)>,
    quality: &OdometryQuality,
    reference_time_us: i64,
) -> v1::Odometry {
    v1::Odometry {
        sigma_velocity_mps: Some(quality.velocity_mps),
        sigma_velocity_fraction: Some(quality.velocity_fraction),
        sigma_yaw_rate_radps: Some(quality.yaw_rate_radps),
        ..odometry(poses, reference_time_us)
    }
}

/// Geodetic poses as columns relative to `reference_time_us`.
#[must_use]
pub fn poses(poses: &[GeoPose], reference_time_us: i64) -> v1::PoseColumns {
    v1::PoseColumns {
        time_offset_us: poses.iter().map(|p| p.time_us.saturating_sub(reference_time_us)).collect(),
        latitude_deg: poses.iter().map(|p| p.at.lat_deg).collect(),
        longitude_deg: poses.iter().map(|p| p.at.lon_deg).collect(),
        yaw_rad: poses.iter().map(|p| p.yaw_rad).collect(),
        sigma_position_m: poses.iter().map(|p| p.sigma_position_m as f32).collect(),
        sigma_yaw_rad: poses.iter().map(|p| p.sigma_yaw_rad as f32).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{any_drive, decode};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn scans_and_odometry_survive_the_wire(drive in any_drive(), reference in -1_000_000_i64..1_000_000) {
            let message = scans(&drive.scans, reference);
            prop_assert!(message.radial_speed_mps.is_empty() && message.rcs_dbsm.is_empty());
            let geometry = decode::scans(&message, reference);
            prop_assert_eq!(geometry.len(), drive.scans.len());
            for (sent, scan) in geometry.iter().zip(&drive.scans) {
                prop_assert_eq!(sent.time_us, scan.time_us);
                prop_assert_eq!(&sent.range_m, &scan.range_m);
                prop_assert_eq!(&sent.azimuth_rad, &scan.azimuth_rad);
                let some = |column: bool| if column { scan.len() } else { 0 };
                let [elevations, times] = [
                    drive.scans.iter().any(|s| !s.elevation_rad.is_empty()),
                    drive.scans.iter().any(|s| !s.detection_time_offset_us.is_empty()),
                ];
                prop_assert_eq!((sent.elevation_rad.len(), sent.detection_time_offset_us.len()), (some(elevations), some(times)));
                if !scan.elevation_rad.is_empty() {
                    prop_assert_eq!(&sent.elevation_rad, &scan.elevation_rad);
                }
            }
            let message = odometry(drive.odometry.iter(), reference);
            prop_assert_eq!(decode::odometry(&message, reference), drive.odometry);
        }
    }
}
