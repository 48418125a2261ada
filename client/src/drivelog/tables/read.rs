//! Reading a drive from a folder.

use std::path::Path;

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::geo::LatLon;
use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use echofix_core::scan::Mount;

use super::super::error::{Error, check_pose};
use super::super::order::in_order;
use super::super::{DriveLog, Flaws, Problem};
use super::table::Table;
use super::{row, scans};

pub(in super::super) fn read(folder: &Path) -> Result<DriveLog, Error> {
    let required =
        |name| Table::find(folder, name)?.ok_or_else(|| Error::NotADriveLog { path: folder.to_owned() });
    let (sensors, scans, odometry) =
        (required("sensors.csv")?, required("scans.csv")?, required("odometry.csv")?);
    let mounts = mounts(&sensors)?;
    let mut flaws = Flaws::default();
    let drive = Drive {
        vehicle: vehicle(folder)?,
        scans: scans::read(&scans, mounts.len(), &mut flaws)?,
        mounts,
        odometry: self::odometry(&odometry, &mut flaws)?,
        reference: poses(folder, "reference.csv", &mut flaws)?,
        truth: poses(folder, "truth.csv", &mut flaws)?,
    };
    Ok(DriveLog { drive, flaws })
}

fn vehicle(folder: &Path) -> Result<String, Error> {
    let mut vehicle = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    if let Some(table) = Table::find(folder, "drive.csv")? {
        table.texts(&["vehicle"], |row: row::VehicleRow| {
            vehicle = row.vehicle;
            Ok(())
        })?;
    }
    Ok(vehicle)
}

/// All of the sensors, or none: what a scan says of them is their number.
fn mounts(table: &Table) -> Result<Vec<Mount>, Error> {
    let mut mounts = Vec::new();
    table.rows(&super::SENSORS, |row: row::SensorRow| {
        if row.index != mounts.len() {
            return Err(Problem::SensorOrder { expected: mounts.len() });
        }
        let mount = Pose2::new(row.x_m, row.y_m, row.yaw_rad);
        if !mount.is_finite() {
            return Err(Problem::NotFinite);
        }
        mounts.push(mount);
        Ok(())
    })?;
    Ok(mounts)
}

fn odometry(table: &Table, flaws: &mut Flaws) -> Result<Trajectory, Error> {
    let mut poses = Vec::new();
    table.records(&super::ODOMETRY, 4, flaws, |cells, line| {
        let pose = Pose2::new(cells.number(1)?, cells.number(2)?, cells.number(3)?);
        if !pose.is_finite() {
            return Err(Problem::NotFinite);
        }
        poses.push((cells.time_us()?, line, pose));
        Ok(())
    })?;
    let mut odometry = Trajectory::default();
    for (time_us, pose) in in_order(poses, &table.name(), flaws) {
        odometry
            .push(time_us, pose)
            .map_err(|e| Error::Unusable { path: table.path(), problem: e.into() })?;
    }
    Ok(odometry)
}

fn poses(folder: &Path, name: &str, flaws: &mut Flaws) -> Result<Vec<GeoPose>, Error> {
    let Some(table) = Table::find(folder, name)? else { return Ok(Vec::new()) };
    let mut poses = Vec::new();
    table.records(&super::GEODETIC, 6, flaws, |cells, line| {
        let pose = GeoPose {
            time_us: cells.time_us()?,
            at: LatLon { lat_deg: cells.number(1)?, lon_deg: cells.number(2)? },
            yaw_rad: cells.number(3)?,
            sigma_position_m: cells.number(4)?,
            sigma_yaw_rad: cells.number(5)?,
        };
        check_pose(&pose)?;
        poses.push((pose.time_us, line, pose));
        Ok(())
    })?;
    Ok(in_order(poses, &table.name(), flaws).into_iter().map(|(_, pose)| pose).collect())
}

#[cfg(test)]
mod tests;
