//! Between the values of [`echofix_core`] and the columns of the contract.
//!
//! Times on the wire are offsets from the enclosing message's reference time, so that they pack
//! into few bytes.

use echofix_core::drive::GeoPose;
use echofix_core::geo::LatLon;
use echofix_core::odometry::{self, Trajectory};
use echofix_core::pose::Pose2;
use echofix_core::scan::{Mount, Scan};
use echofix_proto::v1;

/// Which columns of the detections are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Columns {
    /// Range and azimuth: eight bytes a detection. Enough when movers were dropped on the vehicle.
    #[default]
    Geometry,
    /// Also radial speed and radar cross section, where every scan of the message has them.
    All,
}

/// Why columns do not form the values they stand for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// Columns that belong together differ in length.
    #[error("column `{column}` has {found} values, expected {expected}")]
    ColumnLength {
        /// The offending column.
        column: &'static str,
        /// Its length.
        found: usize,
        /// The length expected.
        expected: usize,
    },
    /// Odometry that is no trajectory.
    #[error(transparent)]
    Odometry(#[from] odometry::Error),
}

/// A mount as a message; metres and radians become `f32`.
#[must_use]
pub fn mount(mount: &Mount) -> v1::SensorMount {
    v1::SensorMount { x_m: mount.x_m as f32, y_m: mount.y_m as f32, yaw_rad: mount.yaw_rad as f32 }
}

/// Scans, oldest first, as columns relative to `reference_time_us`.
#[must_use]
pub fn scans<'a>(
    scans: impl IntoIterator<Item = &'a Scan>,
    reference_time_us: i64,
    columns: Columns,
) -> v1::Scans {
    let scans: Vec<&Scan> = scans.into_iter().collect();
    // An optional column is all or nothing over the message.
    let optional = |column: fn(&Scan) -> &Vec<f32>| -> Vec<f32> {
        let complete = scans.iter().all(|s| column(s).len() == s.len());
        if columns == Columns::Geometry || !complete {
            return Vec::new();
        }
        scans.iter().flat_map(|s| column(s)).copied().collect()
    };
    v1::Scans {
        sensor: scans.iter().map(|s| s.sensor as u32).collect(),
        time_offset_us: scans.iter().map(|s| s.time_us.saturating_sub(reference_time_us)).collect(),
        detection_count: scans.iter().map(|s| s.len() as u32).collect(),
        range_m: scans.iter().flat_map(|s| &s.range_m).copied().collect(),
        azimuth_rad: scans.iter().flat_map(|s| &s.azimuth_rad).copied().collect(),
        radial_speed_mps: optional(|s| &s.radial_speed_mps),
        rcs_dbsm: optional(|s| &s.rcs_dbsm),
    }
}

/// The scans of a message's columns.
///
/// # Errors
/// When columns that belong together differ in length.
pub fn scans_from(message: &v1::Scans, reference_time_us: i64) -> Result<Vec<Scan>, Error> {
    let rows = message.sensor.len();
    same_length("time_offset_us", message.time_offset_us.len(), rows)?;
    same_length("detection_count", message.detection_count.len(), rows)?;
    let detections = message.detection_count.iter().map(|n| *n as usize).sum();
    same_length("range_m", message.range_m.len(), detections)?;
    same_length("azimuth_rad", message.azimuth_rad.len(), detections)?;
    for (column, values) in [("radial_speed_mps", &message.radial_speed_mps), ("rcs_dbsm", &message.rcs_dbsm)]
    {
        if !values.is_empty() {
            same_length(column, values.len(), detections)?;
        }
    }
    let mut from = 0;
    let scans = (0..rows).map(|row| {
        let range = from..from + message.detection_count[row] as usize;
        from = range.end;
        let cut = |values: &[f32]| values.get(range.clone()).unwrap_or_default().to_vec();
        Scan {
            sensor: message.sensor[row] as usize,
            time_us: reference_time_us.saturating_add(message.time_offset_us[row]),
            range_m: cut(&message.range_m),
            azimuth_rad: cut(&message.azimuth_rad),
            radial_speed_mps: cut(&message.radial_speed_mps),
            rcs_dbsm: cut(&message.rcs_dbsm),
        }
    });
    Ok(scans.collect())
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

/// The trajectory of a message's columns.
///
/// # Errors
/// When columns differ in length, times do not increase or a pose is not finite.
pub fn odometry_from(message: &v1::Odometry, reference_time_us: i64) -> Result<Trajectory, Error> {
    let rows = message.time_offset_us.len();
    for (column, values) in [("x_m", &message.x_m), ("y_m", &message.y_m), ("yaw_rad", &message.yaw_rad)] {
        same_length(column, values.len(), rows)?;
    }
    let poses = (0..rows).map(|row| {
        let time_us = reference_time_us.saturating_add(message.time_offset_us[row]);
        (time_us, Pose2::new(message.x_m[row], message.y_m[row], message.yaw_rad[row]))
    });
    Ok(Trajectory::new(poses)?)
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

/// The geodetic poses of a message's columns.
///
/// # Errors
/// When columns differ in length.
pub fn poses_from(message: &v1::PoseColumns, reference_time_us: i64) -> Result<Vec<GeoPose>, Error> {
    let rows = message.time_offset_us.len();
    same_length("latitude_deg", message.latitude_deg.len(), rows)?;
    same_length("longitude_deg", message.longitude_deg.len(), rows)?;
    same_length("yaw_rad", message.yaw_rad.len(), rows)?;
    same_length("sigma_position_m", message.sigma_position_m.len(), rows)?;
    same_length("sigma_yaw_rad", message.sigma_yaw_rad.len(), rows)?;
    let pose = |row: usize| GeoPose {
        time_us: reference_time_us.saturating_add(message.time_offset_us[row]),
        at: LatLon { lat_deg: message.latitude_deg[row], lon_deg: message.longitude_deg[row] },
        yaw_rad: message.yaw_rad[row],
        sigma_position_m: f64::from(message.sigma_position_m[row]),
        sigma_yaw_rad: f64::from(message.sigma_yaw_rad[row]),
    };
    Ok((0..rows).map(pose).collect())
}

fn same_length(column: &'static str, found: usize, expected: usize) -> Result<(), Error> {
    if found == expected { Ok(()) } else { Err(Error::ColumnLength { column, found, expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::any_drive;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn scans_and_odometry_survive_the_wire(drive in any_drive(), reference in -1_000_000_i64..1_000_000) {
            let geometry = scans_from(&scans(&drive.scans, reference, Columns::Geometry), reference).unwrap();
            prop_assert_eq!(geometry.len(), drive.scans.len());
            for (sent, scan) in geometry.iter().zip(&drive.scans) {
                prop_assert_eq!(sent.time_us, scan.time_us);
                prop_assert_eq!(&sent.range_m, &scan.range_m);
                prop_assert_eq!(&sent.azimuth_rad, &scan.azimuth_rad);
                prop_assert!(sent.radial_speed_mps.is_empty() && sent.rcs_dbsm.is_empty());
            }
            let back = odometry_from(&odometry(drive.odometry.iter(), reference), reference).unwrap();
            prop_assert_eq!(back, drive.odometry);
        }
    }

    fn scan(radial_speed_mps: Vec<f32>) -> Scan {
        Scan { range_m: vec![1.0, 2.0], azimuth_rad: vec![0.1, 0.2], radial_speed_mps, ..Scan::default() }
    }

    #[test]
    fn an_optional_column_is_sent_only_when_every_scan_has_it() {
        let (with, without) = (scan(vec![3.0, 4.0]), scan(vec![]));
        assert_eq!(scans([&with, &with], 0, Columns::All).radial_speed_mps, [3.0, 4.0, 3.0, 4.0]);
        assert!(scans([&with, &without], 0, Columns::All).radial_speed_mps.is_empty());
        assert!(scans([&with], 0, Columns::Geometry).radial_speed_mps.is_empty());
    }

    #[test]
    fn columns_that_do_not_fit_are_named() {
        let mut message = scans([&scan(vec![])], 0, Columns::All);
        message.detection_count[0] = 3;
        let error = scans_from(&message, 0).unwrap_err();
        assert_eq!(error, Error::ColumnLength { column: "range_m", found: 2, expected: 3 });
    }
}
