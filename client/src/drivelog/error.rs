//! Why a drive log of either format cannot be read or written.

use std::io;
use std::path::{Path, PathBuf};

use echofix_core::drive::GeoPose;

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
    /// An MCAP file is damaged.
    #[cfg(feature = "mcap")]
    #[error("{}: the MCAP file is damaged ({source}); `mcap recover` may save what is before the damage", .path.display())]
    Damaged {
        /// The file of the drive log.
        path: PathBuf,
        /// The error of the MCAP reader.
        source: ::mcap::McapError,
    },
    /// A message of an MCAP file cannot be used.
    #[error("{}: message {number} of {topic}: {problem}", .path.display())]
    Message {
        /// The file of the drive log.
        path: PathBuf,
        /// The topic of the message.
        topic: String,
        /// Number of the message within its topic, from 1.
        number: u64,
        /// What is wrong and what was expected.
        problem: Problem,
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

pub(super) fn is_finite(pose: &GeoPose) -> bool {
    [pose.at.lat_deg, pose.at.lon_deg, pose.yaw_rad, pose.sigma_position_m, pose.sigma_yaw_rad]
        .iter()
        .all(|v| v.is_finite())
}

pub(super) fn io_error(path: &Path, source: io::Error) -> Error {
    Error::Io { path: path.to_owned(), source }
}
