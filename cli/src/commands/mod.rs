//! One file a subcommand.

pub mod calibrate;
pub mod cluster;
mod decisions;
pub mod demo;
pub mod identity;
pub mod import;
pub mod localize;
pub mod map;
mod map_operations;
mod map_shown;
mod publication;
pub mod serve;
pub mod shell;
pub mod simulate;
pub mod status;
pub mod tiles;
pub mod token;

use std::ops::RangeInclusive;
use std::path::Path;
use std::str::FromStr;

use anyhow::Context;
use echofix_client::drivelog::{self, DriveLog};
use echofix_core::drive::Drive;
use echofix_harness::flaws::DriveFlaws;

use crate::unfinished::Unfinished;

/// A range of a log's scans, counted from 1 in order of time: `10-18`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScanRange(RangeInclusive<usize>);

/// A text that is not a range of scans.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a range of scans; write the first and the last, counted from 1, like 10-18")]
pub struct ScanRangeError(String);

impl FromStr for ScanRange {
    type Err = ScanRangeError;

    fn from_str(text: &str) -> Result<Self, ScanRangeError> {
        let number = |s: &str| s.trim().parse::<usize>().ok().filter(|n| *n > 0);
        text.split_once('-')
            .and_then(|(first, last)| Some((number(first)?, number(last)?)))
            .filter(|(first, last)| first <= last)
            .map(|(first, last)| Self(first..=last))
            .ok_or_else(|| ScanRangeError(text.to_owned()))
    }
}

impl ScanRange {
    /// Removes all other scans from a drive.
    pub fn apply(&self, drive: &mut Drive) {
        let mut number = 0;
        drive.scans.retain(|_| {
            number += 1;
            self.0.contains(&number)
        });
    }
}

/// Reads a drive log, or some of its scans; with it comes what of the log cannot be used.
///
/// # Errors
/// When nothing of it can be used.
pub fn drive_of(path: &Path, scans: Option<&ScanRange>) -> anyhow::Result<(Drive, DriveFlaws)> {
    let log = drivelog::read(path).with_context(|| format!("reading {}", path.display()))?;
    let DriveLog { mut drive, flaws } = log;
    if let Some(scans) = scans {
        scans.apply(&mut drive);
    }
    Ok((drive, DriveFlaws::from(&flaws)))
}

/// Refuses to write a drive log over something, unless that is asked for.
///
/// # Errors
/// When something is there.
pub fn keep(out: &Path, force: bool) -> anyhow::Result<()> {
    let taken = out.is_file() || std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    anyhow::ensure!(!taken || force, "{} is there already; --force writes over it", out.display());
    Ok(())
}

/// Writes a drive log; where nothing was before, all of it or nothing.
///
/// # Errors
/// When it cannot be written.
pub fn write_drive(out: &Path, drive: &Drive) -> anyhow::Result<()> {
    let is_file = out.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mcap"));
    // A file is complete before it has its name.
    let part = if is_file { Some(out.with_extension("mcap.part")) } else { Some(out.to_owned()) };
    let begun = part.filter(|part| !part.exists()).map(|part| Unfinished::begin(&part));
    drivelog::write(out, drive).with_context(|| format!("writing {}", out.display()))?;
    if let Some(begun) = begun {
        begun.finish();
    }
    Ok(())
}

/// An error for machines: the words, and what they rest on, outermost first.
pub fn error_json(error: &anyhow::Error) -> serde_json::Value {
    let causes: Vec<_> = error.chain().skip(1).map(ToString::to_string).collect();
    serde_json::json!({ "error": { "message": error.to_string(), "causes": causes } })
}

/// An error for people: the words, and what they rest on, unless they say it already.
pub fn error_words(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |words, cause| match words.as_str() {
        "" => cause,
        said if said.ends_with(&cause) => words,
        said => format!("{said}: {cause}"),
    })
}

/// Tells what of a log cannot be used, on standard error.
pub fn tell(flaws: &DriveFlaws) {
    for line in flaws.lines() {
        eprintln!("{line}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::scan::Scan;

    /// Catches: a cause that is told twice, because the words name it, too.
    #[test]
    fn a_cause_is_told_once() {
        let missing = drive_of(Path::new("/nowhere/x"), None).unwrap_err();
        assert_eq!(error_words(&missing).matches("os error 2").count(), 1, "{missing:#}");
        let error = anyhow::anyhow!("the disk is full").context("writing a.csv").context("localizing");
        assert_eq!(error_words(&error), "localizing: writing a.csv: the disk is full");
    }

    #[test]
    fn ranges_count_from_one_and_include_both_ends() {
        let mut drive = Drive { scans: vec![Scan::default(); 5], ..Drive::default() };
        for (time_us, scan) in (1..).zip(&mut drive.scans) {
            scan.time_us = time_us;
        }
        "2-3".parse::<ScanRange>().unwrap().apply(&mut drive);
        assert_eq!(drive.scans.iter().map(|s| s.time_us).collect::<Vec<_>>(), [2, 3]);
        for text in ["", "5", "0-3", "4-2", "a-b"] {
            assert_eq!(text.parse::<ScanRange>(), Err(ScanRangeError(text.to_owned())));
        }
    }
}
