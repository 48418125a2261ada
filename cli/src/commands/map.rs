//! `echofix map`: drive logs go to the map; its history, and what operators do with it.

use std::path::PathBuf;

use anyhow::Context;
use echofix_client::drivelog;
use echofix_client::upload::{RecorderConfig, UploadForm};
use echofix_core::gate::Gate;
use echofix_harness::progress;
use echofix_harness::uploading::{UploadedDrive, upload};

use super::ScanRange;
use super::map_operations::{self, MapOperation};

/// The operator's words, where they are first used.
const WORDS: &str = "Words:
  journal     the history of the map: every upload, import and decision is a record of it
  fold        to add a record to the tiles, in the journal's order
  epoch       the number of the last record that a state of the map contains
  compact     to replace old records by a checkpoint; it cannot be undone
  lineage     tells one history of the map from another; a restored backup gets a new one
  datum       by how much uploads were moved onto the map; its mean is the map's own offset
  quarantine  uploads that were kept out of the map, since they do not fit what others uploaded";

/// Arguments of `echofix map`.
#[derive(clap::Args)]
#[command(after_long_help = WORDS, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    operation: Option<MapOperation>,
    /// Address of the service's HTTP port, for operations.
    #[arg(long, global = true, env = "ECHOFIX_HTTP", default_value = "http://127.0.0.1:8080")]
    http: String,
    /// Drive logs: .mcap files or CSV folders.
    #[arg(required = true)]
    drives: Vec<PathBuf>,
    /// Address of the service's gRPC port.
    #[arg(long, env = "ECHOFIX_SERVER", default_value = "http://127.0.0.1:50051")]
    server: String,
    /// Where uploads wait until they are acknowledged; what is there from an earlier run is sent, too.
    #[arg(long, default_value = "echofix-spool")]
    spool: PathBuf,
    /// Upload the scans themselves instead of the evidence gathered from them.
    #[arg(long)]
    raw: bool,
    /// Only these scans of each log, counted from 1, like 1-9.
    #[arg(long)]
    scans: Option<ScanRange>,
    /// Detections farther away are dropped, metres.
    #[arg(long, default_value_t = 50.0)]
    max_range_m: f64,
    /// Poses with a larger one-sigma error of the position are not mapped from, metres; the service
    /// has a limit of its own, see `mapping.max_sigma_position_m`.
    #[arg(long, default_value_t = 0.3)]
    max_sigma_m: f64,
    /// Poses with a larger one-sigma error of the heading are not mapped from, degrees; the service
    /// has a limit of its own, see `mapping.max_sigma_yaw_deg`.
    #[arg(long, default_value_t = 0.5)]
    max_sigma_yaw_deg: f64,
    /// Nothing is mapped within this distance of where a drive began and where it ended, metres. Vehicles
    /// leave out 100 m, for where people live is private; logs given by hand are the operator's own.
    #[arg(long, default_value_t = 0.0)]
    trim_ends_m: f64,
}

/// Runs the subcommand.
///
/// # Errors
/// When a log cannot be read, has no known poses, or the service does not take its uploads; or an operation
/// fails.
pub async fn run(args: Args, json: bool) -> anyhow::Result<()> {
    if let Some(operation) = args.operation {
        // Blocking, like all of it.
        return tokio::task::block_in_place(|| map_operations::run(&operation, &args.http, json));
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
    for path in &args.drives {
        let mut drive = drivelog::read(path).with_context(|| format!("reading {}", path.display()))?;
        if let Some(scans) = &args.scans {
            scans.apply(&mut drive);
        }
        let bar = progress::bar("uploading", 0, json);
        let done = upload(&drive, &args.server, &args.spool, config, &bar).await?;
        bar.finish_and_clear();
        report(&path.display().to_string(), &done, json)?;
    }
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
    if done.duplicates + done.refused > 0 {
        println!(
            "  {} were known already, {} were refused (see refused/ in the spool)",
            done.duplicates, done.refused
        );
    }
    Ok(())
}
