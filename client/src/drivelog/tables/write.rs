//! Writing a drive to a folder.

use std::path::Path;

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::scan::Scan;

use super::super::error::{Error, io_error};
use super::{row, table};

pub(in super::super) fn write(folder: &Path, drive: &Drive) -> Result<(), Error> {
    two_scans_at_once(&drive.scans)?;
    std::fs::create_dir_all(folder).map_err(|e| io_error(folder, e))?;
    table::write(folder, "drive.csv", &["vehicle"], [row::VehicleRow { vehicle: drive.vehicle.clone() }])?;
    let sensors = drive.mounts.iter().enumerate().map(|(index, m)| row::SensorRow {
        index,
        x_m: m.x_m,
        y_m: m.y_m,
        yaw_rad: m.yaw_rad,
    });
    table::write(folder, "sensors.csv", &super::SENSORS, sensors)?;
    scans(folder, &drive.scans)?;
    let odometry = drive.odometry.iter().map(|(time_us, pose)| row::OdometryRow::new(time_us, pose));
    table::write(folder, "odometry.csv", &super::ODOMETRY, odometry)?;
    poses(folder, "reference.csv", &drive.reference)?;
    poses(folder, "truth.csv", &drive.truth)
}

fn poses(folder: &Path, name: &str, poses: &[GeoPose]) -> Result<(), Error> {
    table::write(folder, name, &super::GEODETIC, poses.iter().map(row::GeodeticRow::from))
}

fn scans(folder: &Path, scans: &[Scan]) -> Result<(), Error> {
    let in_space = |scan: &Scan| !(scan.elevation_rad.is_empty() && scan.detection_time_offset_us.is_empty());
    let name = "scans.csv.gz";
    if scans.iter().any(in_space) {
        return table::write(
            folder,
            name,
            &super::SCANS_IN_SPACE,
            scans.iter().flat_map(detections_in_space),
        );
    }
    table::write(folder, name, &super::SCANS, scans.iter().flat_map(detections))
}

/// [`detections`] with all columns.
fn detections_in_space(scan: &Scan) -> impl Iterator<Item = row::DetectionInSpaceRow> + '_ {
    detections(scan).enumerate().map(|(i, row)| row::DetectionInSpaceRow {
        time_us: row.time_us,
        sensor: row.sensor,
        range_m: row.range_m,
        azimuth_rad: row.azimuth_rad,
        radial_speed_mps: row.radial_speed_mps,
        rcs_dbsm: row.rcs_dbsm,
        elevation_rad: scan.elevation_rad.get(i).copied(),
        detection_time_offset_us: scan.detection_time_offset_us.get(i).copied(),
    })
}

/// One row a detection; one without detections for an empty scan.
fn detections(scan: &Scan) -> impl Iterator<Item = row::DetectionRow> + '_ {
    (0..scan.len().max(1)).map(|i| row::DetectionRow {
        time_us: scan.time_us,
        sensor: scan.sensor,
        range_m: scan.range_m.get(i).copied(),
        azimuth_rad: scan.azimuth_rad.get(i).copied(),
        radial_speed_mps: scan.radial_speed_mps.get(i).copied(),
        rcs_dbsm: scan.rcs_dbsm.get(i).copied(),
    })
}

/// Two such scans would be read back as one.
fn two_scans_at_once(scans: &[Scan]) -> Result<(), Error> {
    let same = |pair: &&[Scan]| (pair[0].time_us, pair[0].sensor) == (pair[1].time_us, pair[1].sensor);
    match scans.windows(2).find(same) {
        Some(pair) => Err(Error::Unwritable(format!(
            "two scans of sensor {} are both at {} us, which CSV would join; write MCAP instead",
            pair[0].sensor, pair[0].time_us
        ))),
        None => Ok(()),
    }
}
