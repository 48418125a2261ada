//! `echofix map`: uploads drive logs to the map, and offers what operators do with the map.

use std::path::{Path, PathBuf};

use anyhow::Context;
use echofix_client::drivelog;
use echofix_client::upload::{RecorderConfig, UploadForm};
use echofix_core::gate::{Gate, MAX_RANGE_M};
use echofix_harness::credentials::Credentials;
use echofix_harness::progress;
use echofix_harness::uploading::{UploadedDrive, upload_to};

use super::ScanRange;
use super::map_operations::{self, MapOperation};
use super::ranges::within;

/// The operators' words, where they are needed first.
const WORDS: &str = "\
Words:
  journal     the service's history: one record for each upload, each imported tile and each
              decision of an operator, in the order they came
  fold        to add what a record holds to the tiles of the map; records are folded in the
              journal's order
  epoch       the number of the last record that a state of the map contains; it grows with each
              record, so that a larger epoch is a later map
  roll back   to exclude every record after an epoch; the decision is a record, too
  revoke      to exclude a contributor's uploads so far, or one upload or imported file
  compact     to replace the records before a day by a checkpoint, which holds the tiles they made;
              those records can then no longer be excluded, and this cannot be undone
  lineage     a random number that tells one history of the map from another; it is drawn anew
              when a backup is restored or when the configuration of what counts is changed, and
              vehicles then download their tiles anew
  vetting     to compare an upload with what others contributed, and to accept it, move it onto
              the map or quarantine it
  quarantine  the uploads that vetting kept out of the map, with offset and reason
  datum       by how much vetting moved the uploads over a tile; its mean is the map's own offset,
              and the service subtracts it from every fix";

/// Arguments of `echofix map`.
#[derive(clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true, after_long_help = WORDS)]
pub struct Args {
    #[command(subcommand)]
    operation: Option<MapOperation>,
    /// URL of the service's HTTP port, which the operations use.
    #[arg(long, global = true, env = "ECHOFIX_HTTP", default_value = "http://127.0.0.1:8080")]
    http: String,
    /// The drive logs to upload: .mcap files or folders of CSV files.
    #[arg(required = true)]
    drives: Vec<PathBuf>,
    /// URL of the service's gRPC port, which takes the uploads.
    #[arg(long, env = "ECHOFIX_SERVER", default_value = "http://127.0.0.1:50051")]
    server: String,
    /// Folder in which uploads wait until the service has acknowledged them. Uploads of an earlier run are sent, too.
    #[arg(long, default_value = "echofix-spool")]
    spool: PathBuf,
    /// Upload scans and poses (raw uploads). Without it, the evidence that was built from them.
    #[arg(long)]
    raw: bool,
    /// Upload under this name instead of the log's vehicle: to a service that knows the caller, its own name, or for a gateway
    /// one below it.
    #[arg(long)]
    contributor: Option<String>,
    /// Use only these scans of each log, counted from 1, like 1-9.
    #[arg(long)]
    scans: Option<ScanRange>,
    /// Largest range of a detection, metres. Farther ones are dropped. Raw uploads (--raw) are held against the service's
    /// `radar.max_range_m`, too.
    #[arg(long, default_value_t = MAX_RANGE_M, value_parser = within(1.0..=1000.0))]
    max_range_m: f64,
    /// Largest standard deviation of a pose's position, metres. Less certain poses add nothing to the map. The service
    /// has its own limit, `mapping.max_sigma_position_m`.
    #[arg(long, default_value_t = 0.3, value_parser = within(0.001..=100.0))]
    max_sigma_m: f64,
    /// Largest standard deviation of a pose's heading, degrees. Less certain poses add nothing to the map. The service
    /// has its own limit, `mapping.max_sigma_yaw_deg`.
    #[arg(long, default_value_t = 0.5, value_parser = within(0.001..=180.0))]
    max_sigma_yaw_deg: f64,
    /// Upload nothing within this distance of where a drive began and ended, metres. Vehicles leave out 100 m, to protect
    /// where people live. This command leaves out nothing unless told to: the logs are the operator's own.
    #[arg(long, default_value_t = 0.0, value_parser = within(0.0..=100_000.0))]
    trim_ends_m: f64,
}

/// Runs the subcommand.
///
/// # Errors
/// When a log cannot be read or has no known poses, when the service refuses its uploads, or when an operation fails.
pub async fn run(args: Args, credentials: &Credentials, json: bool) -> anyhow::Result<()> {
    if let Some(operation) = args.operation {
        // The operations block.
        return tokio::task::block_in_place(|| {
            map_operations::run(&operation, &args.http, credentials, json)
        });
    }
    let gate = Gate { max_range_m: args.max_range_m, ..Gate::default() };
    let config = RecorderConfig {
        gate,
        form: if args.raw { UploadForm::Scans } else { UploadForm::Evidence },
        max_sigma_position_m: args.max_sigma_m,
        max_sigma_yaw_rad: args.max_sigma_yaw_deg.to_radians(),
        trim_ends_m: args.trim_ends_m,
        ..RecorderConfig::default()
    };
    let mut failed = 0;
    for path in &args.drives {
        match map_drive(path, &args, credentials, config, json).await {
            Ok(()) => {}
            Err(error) if args.drives.len() == 1 => return Err(error),
            // What is good of the rest is sent all the same.
            Err(error) => {
                eprintln!("{}: {error:#}", path.display());
                failed += 1;
            }
        }
    }
    anyhow::ensure!(failed == 0, "{failed} of {} drives were not mapped", args.drives.len());
    Ok(())
}

async fn map_drive(
    path: &Path,
    args: &Args,
    credentials: &Credentials,
    config: RecorderConfig,
    json: bool,
) -> anyhow::Result<()> {
    let mut drive = drivelog::read(path).with_context(|| format!("reading {}", path.display()))?;
    if let Some(contributor) = &args.contributor {
        drive.vehicle.clone_from(contributor);
    }
    if let Some(scans) = &args.scans {
        scans.apply(&mut drive);
    }
    let bar = progress::bar("uploading", 0, json);
    let done = upload_to(&drive, credentials.endpoint(&args.server)?, &args.spool, config, &bar).await?;
    bar.finish_and_clear();
    report(&path.display().to_string(), &done, json)?;
    let nothing = done.uploads + done.duplicates == 0 && done.refused > 0;
    anyhow::ensure!(!nothing, "every upload of {} was refused", path.display());
    Ok(())
}

fn report(path: &str, done: &UploadedDrive, json: bool) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::json!({ "drive": path, "result": serde_json::to_value(done)? }));
        return Ok(());
    }
    println!(
        "{path}: {} uploads acknowledged with {} detections in {} kB",
        done.uploads,
        done.detections,
        done.bytes / 1000
    );
    println!("  left out: {}", done.left_out);
    for finding in &done.findings {
        println!("  suspicious: {finding}");
    }
    if done.duplicates + done.refused > 0 {
        println!(
            "  {} were known to the service already, {} were refused (see refused/ in the spool)",
            done.duplicates, done.refused
        );
    }
    Ok(())
}
