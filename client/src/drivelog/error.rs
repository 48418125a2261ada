//! Why a drive log of either format cannot be read or written.

use std::io;
use std::path::{Path, PathBuf};

use echofix_core::drive::GeoPose;
use echofix_core::geo::LatLon;

use super::Problem;

/// Why a drive log cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file system refuses.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file or folder of the drive log.
        path: PathBuf,
        /// The error of the file system.
        source: io::Error,
    },
    /// Neither a `*.mcap` file nor a folder with a drive.
    #[error("{} is not a drive log; expected a .mcap file or a folder with sensors.csv, scans.csv and odometry.csv", .path.display())]
    NotADriveLog {
        /// The path that was to be read.
        path: PathBuf,
    },
    /// A table is there twice, or twice and compressed.
    #[error("{} and its .gz twin both exist; remove one", .path.display())]
    Twice {
        /// The uncompressed file.
        path: PathBuf,
    },
    /// A row of a table cannot be used.
    #[error("{} line {line}: {problem}", .path.display())]
    Row {
        /// The file of the drive log.
        path: PathBuf,
        /// Line of the (decompressed) file, from 1.
        line: u64,
        /// What is wrong and what was expected.
        problem: Problem,
    },
    /// A part of a drive log cannot be used.
    #[error("{}: {problem}", .path.display())]
    Unusable {
        /// The file of the drive log.
        path: PathBuf,
        /// What is wrong with it.
        problem: Problem,
    },
    /// A format that this build does not know.
    #[error(
        "{}: this program was built without the feature `{feature}` of echofix-client, which such drive logs need",
        .path.display()
    )]
    FormatOff {
        /// The file or folder of the drive log.
        path: PathBuf,
        /// The feature to build with.
        feature: &'static str,
    },
    /// Nothing of an MCAP file can be read.
    #[error("{}: the MCAP file is damaged, and nothing of it can be used: {problem}", .path.display())]
    Damaged {
        /// The file of the drive log.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// An MCAP file that is not a drive.
    #[error("{}: {problem}", .path.display())]
    NotADrive {
        /// The file of the drive log.
        path: PathBuf,
        /// What is missing or wrong.
        problem: String,
    },
    /// A drive that the format cannot hold.
    #[error("the drive cannot be written: {0}")]
    Unwritable(String),
}

/// What is wrong with a pose, if anything is.
pub(super) fn check_pose(pose: &GeoPose) -> Result<(), Problem> {
    if !is_finite(pose) {
        return Err(Problem::NotFinite);
    }
    let LatLon { lat_deg, lon_deg } = pose.at;
    if lat_deg.abs() > 90.0 || lon_deg.abs() > 180.0 {
        return Err(Problem::NotAPosition { lat_deg, lon_deg });
    }
    let sigmas = [("sigma_position_m", pose.sigma_position_m), ("sigma_yaw_rad", pose.sigma_yaw_rad)];
    match sigmas.into_iter().find(|(_, value)| *value < 0.0) {
        Some((column, value)) => Err(Problem::NegativeSigma { column, value }),
        None => Ok(()),
    }
}

/// How far two poses are from each other, metres, roughly.
pub(super) fn apart_m(a: &GeoPose, b: &GeoPose) -> f64 {
    const METRES_PER_DEG: f64 = 111_195.0;
    let east_deg = (b.at.lon_deg - a.at.lon_deg + 180.0).rem_euclid(360.0) - 180.0;
    let narrowed = a.at.lat_deg.to_radians().cos();
    METRES_PER_DEG * (b.at.lat_deg - a.at.lat_deg).hypot(narrowed * east_deg)
}

/// Where receivers say that they are when they know no place.
pub(super) fn is_nowhere(pose: &GeoPose) -> bool {
    pose.at == LatLon { lat_deg: 0.0, lon_deg: 0.0 }
}

pub(super) fn is_finite(pose: &GeoPose) -> bool {
    [pose.at.lat_deg, pose.at.lon_deg, pose.yaw_rad, pose.sigma_position_m, pose.sigma_yaw_rad]
        .iter()
        .all(|v| v.is_finite())
}

pub(super) fn io_error(path: &Path, source: io::Error) -> Error {
    Error::Io { path: path.to_owned(), source }
}
