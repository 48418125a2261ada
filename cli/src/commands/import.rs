//! `echofix import`: radar data of public data sets becomes a drive log.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use echofix_client::import;
use echofix_core::drive::Drive;
use echofix_core::scan::Scan;

/// Arguments of `echofix import`.
#[derive(clap::Args)]
pub struct Args {
    /// The data set.
    dataset: Dataset,
    /// The folder that holds the data.
    from: PathBuf,
    /// The drive log to write: a file whose name ends in .mcap, or a folder of CSV files.
    out: PathBuf,
    /// Write over what is there.
    #[arg(long)]
    force: bool,
}

/// Data sets that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Dataset {
    /// A part of RADIATE: a spinning Navtech radar, decoded to points (`scans.csv.gz`, `poses.csv`, `gps_ins.csv`).
    Radiate,
    /// A part of comma2k19: the object tracks of a production car's radar.
    Comma2k19,
}

/// Runs the subcommand.
///
/// # Errors
/// When something is in the log's place, the data cannot be read or the log cannot be written.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    super::keep(&args.out, args.force)?;
    let drive = match args.dataset {
        Dataset::Radiate => import::radiate(&args.from)?,
        Dataset::Comma2k19 => import::comma2k19(&args.from)?,
    };
    super::write_drive(&args.out, &drive)?;
    report(&drive, &args.out, json);
    Ok(())
}

/// Prints what a written log holds.
pub fn report(drive: &Drive, out: &Path, json: bool) {
    let detections: usize = drive.scans.iter().map(Scan::len).sum();
    let seconds = drive
        .scans
        .first()
        .zip(drive.scans.last())
        .map_or(0.0, |(a, b)| (b.time_us - a.time_us) as f64 * 1e-6);
    let metres = drive.odometry.travelled_m();
    if json {
        let report = serde_json::json!({
            "out": out, "vehicle": drive.vehicle, "scans": drive.scans.len(), "detections": detections,
            "duration_s": seconds, "travelled_m": metres,
        });
        println!("{report}");
    } else {
        println!(
            "{}: {} scans with {detections} detections over {seconds:.1} s and {metres:.0} m",
            out.display(),
            drive.scans.len()
        );
    }
}
