//! Reading and writing drive logs of either format.

use std::path::Path;

use echofix_core::drive::Drive;

use super::Flaws;
use super::error::{Error, io_error, is_finite};
#[cfg(feature = "mcap")]
use super::mcap::{read as read_file, write as write_file};
#[cfg(feature = "csv")]
use super::tables::{read as read_folder, write as write_folder};

/// A drive as it was read.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DriveLog {
    /// The drive.
    pub drive: Drive,
    /// What its log holds besides, which cannot be used: tell it to whoever recorded it.
    pub flaws: Flaws,
}

/// Reads a drive, all that is good of it.
///
/// # Errors
/// When there is none, or nothing of it can be used: naming the first row or message that cannot.
pub fn read(path: impl AsRef<Path>) -> Result<DriveLog, Error> {
    let path = path.as_ref();
    let metadata = std::fs::metadata(path).map_err(|source| io_error(path, source))?;
    if metadata.is_dir() { read_folder(path) } else { read_file(path) }
}

/// Writes a drive: one MCAP file when the path ends in `.mcap`, otherwise a folder of CSV files.
///
/// What was at the path is replaced: an MCAP file as a whole once the new one is complete, in a
/// folder the files of the drive log only.
///
/// # Errors
/// When the file system refuses or the drive holds what the format cannot.
pub fn write(path: impl AsRef<Path>, drive: &Drive) -> Result<(), Error> {
    let path = path.as_ref();
    check(drive)?;
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mcap")) {
        write_file(path, drive)
    } else {
        write_folder(path, drive)
    }
}

#[cfg(not(feature = "mcap"))]
fn read_file(path: &Path) -> Result<DriveLog, Error> {
    Err(Error::FormatOff { path: path.to_owned(), feature: "mcap" })
}

#[cfg(not(feature = "mcap"))]
fn write_file(path: &Path, _: &Drive) -> Result<(), Error> {
    Err(Error::FormatOff { path: path.to_owned(), feature: "mcap" })
}

#[cfg(not(feature = "csv"))]
fn read_folder(path: &Path) -> Result<DriveLog, Error> {
    Err(Error::FormatOff { path: path.to_owned(), feature: "csv" })
}

#[cfg(not(feature = "csv"))]
fn write_folder(path: &Path, _: &Drive) -> Result<(), Error> {
    Err(Error::FormatOff { path: path.to_owned(), feature: "csv" })
}

/// What is not checked here would not be read back.
fn check(drive: &Drive) -> Result<(), Error> {
    for scan in &drive.scans {
        let refuse = |problem: String| Error::Unwritable(format!("scan at {} us: {problem}", scan.time_us));
        scan.validate().map_err(|e| refuse(e.to_string()))?;
        if scan.sensor >= drive.mounts.len() {
            let problem = format!("it names sensor {} of {}", scan.sensor, drive.mounts.len());
            return Err(refuse(problem));
        }
    }
    let poses = drive.reference.iter().chain(&drive.truth);
    match poses.into_iter().find(|pose| !is_finite(pose)) {
        Some(pose) => Err(Error::Unwritable(format!("the pose at {} us is not finite", pose.time_us))),
        None => Ok(()),
    }
}

#[cfg(all(test, feature = "mcap", feature = "csv"))]
mod tests {
    use super::*;
    use crate::testing::any_drive;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn both_formats_give_back_exactly_what_was_written(drive in any_drive()) {
            let dir = tempfile::tempdir().unwrap();
            for name in ["drive.mcap", "folder"] {
                let path = dir.path().join(name);
                write(&path, &drive).unwrap();
                let log = read(&path).unwrap();
                prop_assert!(log.flaws.is_empty(), "{}", log.flaws);
                prop_assert_eq!(&log.drive, &drive, "{}", name);
                // Once more over what is there.
                write(&path, &drive).unwrap();
                prop_assert_eq!(&read(&path).unwrap().drive, &drive, "{}", name);
            }
        }
    }

    #[test]
    fn what_is_no_drive_log_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        assert!(matches!(read(dir.path()), Err(Error::NotADriveLog { .. })));
        assert!(matches!(read(dir.path().join("nothing")), Err(Error::Io { .. })));
        let text = dir.path().join("notes.txt");
        std::fs::write(&text, "hello").unwrap();
        assert!(read(&text).is_err());
    }

    #[test]
    fn what_could_not_be_read_back_is_not_written() {
        let dir = tempfile::tempdir().unwrap();
        let scans = vec![echofix_core::scan::Scan::default()];
        let drive = Drive { scans, ..Drive::default() };
        let error = write(dir.path().join("d.mcap"), &drive).unwrap_err();
        assert!(error.to_string().contains("names sensor 0 of 0"), "{error}");
    }
}
