//! Reading a drive from a folder.

use std::collections::BTreeMap;
use std::path::Path;

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::geo::LatLon;
use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use echofix_core::scan::Mount;

use super::super::error::{Error, apart_m, check_pose, is_nowhere};
use super::super::jumps::without_jumps;
use super::super::order::in_order;
use super::super::{DriveLog, Flaws, Problem};
use super::table::Table;
use super::{row, scans};

pub(in super::super) fn read(folder: &Path) -> Result<DriveLog, Error> {
    let required =
        |name| Table::find(folder, name)?.ok_or_else(|| Error::NotADriveLog { path: folder.to_owned() });
    let (sensors, scans, odometry) =
        (required("sensors.csv")?, required("scans.csv")?, required("odometry.csv")?);
    let mut flaws = Flaws::default();
    let mounts = mounts(&sensors, &mut flaws)?;
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

/// The sensors by their numbers, from 0 without a gap, in whatever order they stand. What a scan says of them is their number: of two
/// places for one none is taken for the right one.
fn mounts(table: &Table, flaws: &mut Flaws) -> Result<Vec<Mount>, Error> {
    let mut mounts: BTreeMap<usize, Mount> = BTreeMap::new();
    let mut twice = None;
    table.records(&super::SENSORS, 4, flaws, |cells, _| {
        let sensor = cells.index(0)?;
        let mount = Pose2::new(cells.number(1)?, cells.number(2)?, cells.number(3)?);
        if !mount.is_finite() {
            return Err(Problem::NotFinite);
        }
        match mounts.insert(sensor, mount) {
            None => Ok(()),
            Some(before) => {
                twice = twice.or((before != mount).then_some(sensor));
                Err(Problem::Doubled)
            }
        }
    })?;
    let unusable = |problem| Error::Unusable { path: table.path(), problem };
    if let Some(sensor) = twice {
        return Err(unusable(Problem::TwoMounts { sensor }));
    }
    let missing = (0..mounts.len()).find(|sensor| !mounts.contains_key(sensor));
    let Some(expected) = missing else { return Ok(mounts.into_values().collect()) };
    // The row that cannot be read is the one that is missing.
    let bad =
        flaws.skipped.iter().find(|skipped| skipped.part == table.name() && skipped.reason != "doubled");
    Err(match bad {
        Some(bad) => Error::Row {
            path: table.path(),
            line: bad.first,
            problem: Problem::Unparsable(bad.problem.clone()),
        },
        None => unusable(Problem::SensorOrder { expected }),
    })
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
    let (part, apart_m) = (table.name(), |a: &Pose2, b: &Pose2| a.distance_m(b));
    let poses = in_order(poses, &part, flaws);
    for (time_us, pose) in without_jumps(poses, &part, flaws, apart_m, |_| false) {
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
    let part = table.name();
    let poses = in_order(poses, &part, flaws);
    Ok(without_jumps(poses, &part, flaws, apart_m, is_nowhere).into_iter().map(|(_, pose)| pose).collect())
}

#[cfg(test)]
mod tests;
