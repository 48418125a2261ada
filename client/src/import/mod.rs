//! Public radar data as drives.
//!
//! Both sets are fragments of public data, prepared as CSV; neither drives a street twice, so neither
//! can prove a localization. They show that real detections, real poses and real clocks go
//! through. What is not known about them is said at each function, and in the sigmas.

mod comma2k19;
mod local_frame;
mod radiate;

pub use comma2k19::comma2k19;
pub use radiate::radiate;

use std::path::{Path, PathBuf};

use echofix_core::drive::GeoPose;
use echofix_core::odometry::{self, Trajectory};
use echofix_core::pose::Pose2;
use echofix_core::scan::Scan;
use serde::Deserialize;

use crate::drivelog::{self, Problem, tables::Table};
use local_frame::LocalFrame;

/// Why foreign data cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file is missing.
    #[error("{} is missing (also as .gz); expected the folder of the prepared {set} fragment", .path.display())]
    Missing {
        /// The file of the data set.
        path: PathBuf,
        /// The name of the data set.
        set: &'static str,
    },
    /// A file or a row of it cannot be used.
    #[error(transparent)]
    Table(#[from] drivelog::Error),
    /// The poses are no trajectory.
    #[error("poses.csv: {0}")]
    Poses(#[from] odometry::Error),
    /// A file holds nothing.
    #[error("{} has no rows", .path.display())]
    Empty {
        /// The file of the data set.
        path: PathBuf,
    },
}

/// The files of one fragment.
struct DataFolder<'a> {
    path: &'a Path,
    set: &'static str,
}

impl DataFolder<'_> {
    fn table(&self, name: &str) -> Result<Table, Error> {
        Table::find(self.path, name)?
            .ok_or_else(|| Error::Missing { path: self.path.join(name), set: self.set })
    }

    fn empty(&self, name: &str) -> Error {
        Error::Empty { path: self.path.join(name) }
    }
}

/// A row of `poses.csv` in either set.
#[derive(Deserialize)]
struct PoseRow {
    t: f64,
    x_east: f64,
    y_north: f64,
    heading: f64,
}

/// Poses in a local frame as odometry. `start_us` is the time of `t` = 0.
fn poses(folder: &DataFolder, start_us: i64) -> Result<Trajectory, Error> {
    let mut rows = Vec::new();
    folder.table("poses.csv")?.rows(&["t", "x_east", "y_north", "heading"], |row: PoseRow| {
        let pose = Pose2::new(row.x_east, row.y_north, row.heading);
        if !pose.is_finite() {
            return Err(Problem::NotFinite);
        }
        rows.push((start_us + micros(row.t)?, pose));
        Ok(())
    })?;
    if rows.is_empty() {
        return Err(folder.empty("poses.csv"));
    }
    Ok(Trajectory::new(rows)?)
}

/// The same poses on the globe.
fn on_the_globe(
    poses: &Trajectory,
    frame: &LocalFrame,
    sigma_position_m: f64,
    sigma_yaw_rad: f64,
) -> Vec<GeoPose> {
    let geodetic = |(time_us, pose)| {
        let (at, yaw_rad) = frame.to_geodetic(&pose);
        GeoPose { time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad }
    };
    poses.iter().map(geodetic).collect()
}

/// Adds a detection given in metres forward and left of the sensor.
fn detect(scan: &mut Scan, forward_m: f64, left_m: f64) -> Result<(), Problem> {
    if !(forward_m.is_finite() && left_m.is_finite()) {
        return Err(Problem::NotFinite);
    }
    scan.range_m.push(forward_m.hypot(left_m) as f32);
    scan.azimuth_rad.push(left_m.atan2(forward_m) as f32);
    Ok(())
}

/// Seconds as microseconds.
fn micros(seconds: f64) -> Result<i64, Problem> {
    // Beyond this a double no longer holds a microsecond.
    if seconds.abs() < 4e9 { Ok((seconds * 1e6).round() as i64) } else { Err(Problem::NotATime { seconds }) }
}

#[cfg(test)]
fn data_dir(name: &str) -> PathBuf {
    let dir =
        std::env::var_os("ECHOFIX_DATA_DIR").expect("set ECHOFIX_DATA_DIR to the folder of the data sets");
    PathBuf::from(dir).join(name)
}
