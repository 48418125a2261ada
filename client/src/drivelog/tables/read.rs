//! Reading a drive from a folder.

use std::f32::consts::FRAC_PI_2;
use std::path::Path;

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use echofix_core::scan::{self, Mount, Scan};

use super::super::Problem;
use super::super::error::{Error, is_finite};
use super::row;
use super::table::Table;

pub(in super::super) fn read(folder: &Path) -> Result<Drive, Error> {
    let required =
        |name| Table::find(folder, name)?.ok_or_else(|| Error::NotADriveLog { path: folder.to_owned() });
    let (sensors, scans, odometry) =
        (required("sensors.csv")?, required("scans.csv")?, required("odometry.csv")?);
    let mounts = mounts(&sensors)?;
    Ok(Drive {
        vehicle: vehicle(folder)?,
        scans: self::scans(&scans, mounts.len())?,
        mounts,
        odometry: self::odometry(&odometry)?,
        reference: poses(folder, "reference.csv")?,
        truth: poses(folder, "truth.csv")?,
    })
}

fn vehicle(folder: &Path) -> Result<String, Error> {
    let mut vehicle = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    if let Some(table) = Table::find(folder, "drive.csv")? {
        table.rows(&["vehicle"], |row: row::VehicleRow| {
            vehicle = row.vehicle;
            Ok(())
        })?;
    }
    Ok(vehicle)
}

fn mounts(table: &Table) -> Result<Vec<Mount>, Error> {
    let mut mounts = Vec::new();
    table.rows(&super::SENSORS, |row: row::SensorRow| {
        if row.index != mounts.len() {
            return Err(Problem::SensorOrder { expected: mounts.len() });
        }
        let mount = Pose2::new(row.x_m, row.y_m, row.yaw_rad);
        finite(mount.is_finite())?;
        mounts.push(mount);
        Ok(())
    })?;
    Ok(mounts)
}

fn scans(table: &Table, sensors: usize) -> Result<Vec<Scan>, Error> {
    let mut scans: Vec<Scan> = Vec::new();
    table.rows(&super::SCANS[..4], |row: row::DetectionInSpaceRow| {
        let row::DetectionInSpaceRow { time_us, sensor, .. } = row;
        if sensor >= sensors {
            return Err(Problem::UnknownSensor { sensor, sensors });
        }
        let continues = scans.last().is_some_and(|s| (s.time_us, s.sensor) == (time_us, sensor));
        if !continues {
            scans.push(Scan { sensor, time_us, ..Scan::default() });
        }
        scans.last_mut().map_or(Ok(()), |scan| add(scan, &row))
    })?;
    Ok(scans)
}

/// Adds a detection, minding that the optional columns are whole or empty.
fn add(scan: &mut Scan, row: &row::DetectionInSpaceRow) -> Result<(), Problem> {
    let (range_m, azimuth_rad) = match (row.range_m, row.azimuth_rad) {
        (Some(range_m), Some(azimuth_rad)) => (range_m, azimuth_rad),
        (None, None) if scan.is_empty() => return Ok(()),
        _ => return Err(Problem::HalfADetection),
    };
    let optional = [row.radial_speed_mps, row.rcs_dbsm, row.elevation_rad];
    finite(optional.iter().flatten().chain([&range_m, &azimuth_rad]).all(|v| v.is_finite()))?;
    if range_m < 0.0 {
        return Err(Problem::NegativeRange { range_m });
    }
    if let Some(elevation) = row.elevation_rad.filter(|elevation| elevation.abs() > FRAC_PI_2) {
        return Err(scan::Error::NoElevation { row: scan.len(), value: elevation.to_string() }.into());
    }
    let before = scan.len();
    let columns = [&mut scan.radial_speed_mps, &mut scan.rcs_dbsm, &mut scan.elevation_rad];
    for ((column, value), values) in
        ["radial_speed_mps", "rcs_dbsm", "elevation_rad"].into_iter().zip(optional).zip(columns)
    {
        whole(column, values, value, before)?;
    }
    let offsets = &mut scan.detection_time_offset_us;
    whole("detection_time_offset_us", offsets, row.detection_time_offset_us, before)?;
    scan.range_m.push(range_m);
    scan.azimuth_rad.push(azimuth_rad);
    Ok(())
}

/// Adds a value to an optional column, which `before` rows have, all or none.
fn whole<T>(
    column: &'static str,
    values: &mut Vec<T>,
    value: Option<T>,
    before: usize,
) -> Result<(), Problem> {
    if before > 0 && value.is_some() == values.is_empty() {
        return Err(Problem::PartialColumn { column });
    }
    values.extend(value);
    Ok(())
}

fn odometry(table: &Table) -> Result<Trajectory, Error> {
    let mut odometry = Trajectory::default();
    table.rows(&super::ODOMETRY, |row: row::OdometryRow| Ok(odometry.push(row.time_us, row.pose())?))?;
    Ok(odometry)
}

fn poses(folder: &Path, name: &str) -> Result<Vec<GeoPose>, Error> {
    let mut poses = Vec::new();
    let Some(table) = Table::find(folder, name)? else { return Ok(poses) };
    table.rows(&super::GEODETIC, |row: row::GeodeticRow| {
        let pose = GeoPose::from(&row);
        finite(is_finite(&pose))?;
        poses.push(pose);
        Ok(())
    })?;
    Ok(poses)
}

fn finite(is_finite: bool) -> Result<(), Problem> {
    if is_finite { Ok(()) } else { Err(Problem::NotFinite) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drivelog;
    use std::fs;

    const SENSORS: &str = "sensor,x_m,y_m,yaw_rad\n0,3.5,0,0\n1,2.5,0.8,1.57\n";
    const ODOMETRY: &str = "time_us,x_m,y_m,yaw_rad\n0,0,0,0\n100000,1.5,0,0\n";

    fn read_with(scans: &str) -> Result<Drive, Error> {
        let dir = tempfile::tempdir().unwrap();
        for (name, text) in [("sensors.csv", SENSORS), ("odometry.csv", ODOMETRY), ("scans.csv", scans)] {
            fs::write(dir.path().join(name), text).unwrap();
        }
        drivelog::read(dir.path())
    }

    #[test]
    fn a_hand_written_folder_is_a_drive() {
        // Columns in another order, one not known, no optional ones.
        let drive = read_with(
            "range_m, azimuth_rad, sensor, time_us, note\n1.5,0.5,0,0,a\n2,-0.5,0,0,b\n3,0,1,0,c\n",
        )
        .unwrap();
        assert_eq!(drive.scans.len(), 2);
        assert_eq!(drive.scans[0].range_m, [1.5, 2.0]);
        assert_eq!(drive.scans[1].sensor, 1);
        assert_eq!((drive.mounts.len(), drive.odometry.len()), (2, 2));
        assert!(drive.reference.is_empty());
    }

    #[test]
    fn errors_name_file_line_and_what_to_do() {
        let header = "time_us,sensor,range_m,azimuth_rad,radial_speed_mps\n";
        for (rows, line, words) in [
            ("0,0,1,0,\n0,2,1,0,\n", 3, "sensors.csv, which has 2"),
            ("0,0,-1,0,\n", 2, "distances from the sensor"),
            ("0,0,1,0,2\n0,0,1,0,\n", 3, "in all rows of a scan or in none"),
            ("0,0,NaN,0,\n", 2, "finite"),
            ("0,0,1,,\n", 2, "both be given"),
            ("0,0,x,0,\n", 2, "invalid float"),
            ("0,0,1\n", 2, "fields"),
            ("0.5,0,1,0,\n", 2, "invalid digit"),
        ] {
            let error = read_with(&format!("{header}{rows}")).unwrap_err();
            let message = error.to_string();
            assert!(message.contains(&format!("scans.csv line {line}")), "{message}");
            assert!(message.contains(words), "{message}");
        }
        let header = "time_us,sensor,range_m,azimuth_rad,elevation_rad,detection_time_offset_us\n";
        for (rows, line, words) in [
            ("0,0,1,0,12.5,\n", 2, "elevations are radians"),
            ("0,0,1,0,0.1,7\n0,0,1,0,,7\n", 3, "elevation_rad must be given in all rows"),
            ("0,0,1,0,,7\n0,0,1,0,,\n", 3, "detection_time_offset_us must be given in all rows"),
        ] {
            let message = read_with(&format!("{header}{rows}")).unwrap_err().to_string();
            assert!(message.contains(&format!("line {line}")) && message.contains(words), "{message}");
        }
        let error = read_with("time_us,sensor\n0,0\n").unwrap_err();
        assert!(error.to_string().contains("line 1: column `range_m` is missing"), "{error}");
    }
}
