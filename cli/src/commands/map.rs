//! `echofix map`: uploads drive logs to the map, and offers what operators do with the map.

use std::path::{Path, PathBuf};
use std::time::Duration;

use echofix_client::upload::{RecorderConfig, UploadForm};
use echofix_core::gate::{Gate, MAX_RANGE_M};
use echofix_harness::credentials::Credentials;
use echofix_harness::progress;
use echofix_harness::ranges::within;
use echofix_harness::uploading::{Interrupted, Publication, Spooled, UploadedDrive, upload_to};
use tokio::sync::watch;

use super::ScanRange;
use super::map_operations::{self, MapOperation};
use super::publication::{publication, wanted};
use super::status::why_waiting;

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
    /// URL of the service's HTTP port, which the operations use. Without it, that of the profile, or `http://127.0.0.1:8080`.
    #[arg(long, global = true, env = "ECHOFIX_HTTP")]
    http: Option<String>,
    /// The drive logs to upload: .mcap files or folders of CSV files.
    #[arg(required = true)]
    drives: Vec<PathBuf>,
    /// URL of the service's gRPC port, which takes the uploads. Without it, that of the profile, or `http://127.0.0.1:50051`.
    #[arg(long, env = "ECHOFIX_SERVER")]
    server: Option<String>,
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
    /// Upload only what the service wants: nothing of places that it knows well, until they are due again. It is asked along each
    /// drive's poses, and wants everything unless `mapping.enough_passes` is set.
    #[arg(long)]
    wanted_only: bool,
    /// Give up when the service has acknowledged nothing for this long, seconds. What it has not acknowledged stays in the spool.
    #[arg(long, default_value_t = 60.0, value_parser = within(0.1..=86_400.0))]
    patience_s: f64,
}

/// Runs the subcommand.
///
/// # Errors
/// When a log cannot be read or has no known poses, when the service refuses its uploads, or when an operation fails.
pub async fn run(args: Args, credentials: &Credentials, json: bool) -> anyhow::Result<()> {
    if let Some(operation) = args.operation {
        let (http, credentials) = (args.http, credentials.clone());
        let operated = move || {
            let http = credentials.http(http.as_deref());
            map_operations::run(&operation, http, &credentials, json)
        };
        return crate::interruptible(crate::off_the_runtime(operated)).await;
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
    let interrupted = noticed();
    let mut failed = 0;
    for path in &args.drives {
        anyhow::ensure!(!*interrupted.borrow(), "interrupted before {}", path.display());
        match map_drive(path, &args, credentials, config, (&interrupted, json)).await {
            Ok(()) => {}
            Err(error) if args.drives.len() == 1 || error.is::<Interrupted>() => return Err(error),
            // What is good of the rest is sent all the same.
            Err(error) => {
                if json {
                    let error = &super::error_json(&error)["error"];
                    println!("{}", serde_json::json!({ "drive": path, "error": error }));
                }
                eprintln!("{}: {}", path.display(), super::error_words(&error));
                failed += 1;
            }
        }
    }
    anyhow::ensure!(failed == 0, "{failed} of {} drives were not mapped", args.drives.len());
    Ok(())
}

/// Turns true when the user has had enough.
fn noticed() -> watch::Receiver<bool> {
    let (tell, noticed) = watch::channel(false);
    tokio::spawn(async move {
        if tokio::signal::ctrl_c().await.is_ok() {
            tell.send_replace(true);
        }
    });
    noticed
}

async fn map_drive(
    path: &Path,
    args: &Args,
    credentials: &Credentials,
    config: RecorderConfig,
    (interrupted, json): (&watch::Receiver<bool>, bool),
) -> anyhow::Result<()> {
    let (mut drive, mut flaws) = super::drive_of(path, args.scans.as_ref())?;
    if let Some(contributor) = &args.contributor {
        drive.vehicle.clone_from(contributor);
    }
    let bar = progress::bar("uploads acknowledged", 0, json);
    let patience = Duration::from_secs_f64(args.patience_s);
    let service = credentials.endpoint(credentials.server(args.server.as_deref()))?;
    let asked = service.clone();
    let wanted = if args.wanted_only { Some(wanted(&drive, &service).await?) } else { None };
    let recorded_as = (config, wanted);
    let uploaded =
        upload_to(&drive, service, &args.spool, recorded_as, (patience, interrupted.clone()), &bar).await;
    bar.finish_and_clear();
    let mut done = uploaded.inspect_err(|_| super::tell(&flaws))?;
    done.served = publication(&asked, &done).await;
    flaws.add(std::mem::take(&mut done.flaws));
    done.flaws = flaws;
    report(&path.display().to_string(), &done, json)
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
    done.flaws.lines().for_each(|line| println!("  {line}"));
    for finding in &done.findings {
        println!("  suspicious: {finding}");
    }
    if done.not_wanted > 0 {
        println!(
            "  {} uploads were not made: the service knows their places well for now (--wanted-only)",
            done.not_wanted
        );
    }
    if done.duplicates > 0 {
        println!(
            "  {} of them the service had already: this drive was mapped before, and counts once",
            done.duplicates
        );
    }
    if done.days_behind_map > 0 {
        println!(
            "  the drive is {} days older than the newest evidence of the map: it counts for less, or no more",
            done.days_behind_map
        );
    }
    if let Some(Publication { tiles, waiting, contributors, needed }) = done.served
        && let Some(why) = why_waiting((waiting, tiles), contributors.into(), needed.into())
    {
        println!("  {why}");
    }
    if done.refused > 0 {
        println!("  {} were refused (see refused/ in the spool)", done.refused);
    }
    if done.spooled.found > 0 {
        let Spooled { found, acknowledged, lost } = done.spooled;
        println!(
            "  of {found} uploads that lay in the spool, {acknowledged} were acknowledged and {lost} lost"
        );
    }
    for error in done.errors.iter().filter(|error| error.count > 1) {
        println!("  {} times: {}", error.count, error.message);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use echofix_harness::uploading::{Publication, UploadedDrive};
    use serde_json::Value;

    /// Catches: a schema that describes another command than this one.
    #[test]
    fn the_schema_names_what_is_printed() {
        let schema: Value = serde_json::from_str(include_str!("../../../docs/command.schema.json")).unwrap();
        let described = |of: &Value| -> Vec<String> {
            let mut names: Vec<_> = of["required"]
                .as_array()
                .unwrap()
                .iter()
                .map(|name| name.as_str().unwrap().to_owned())
                .collect();
            names.sort();
            names
        };
        let printed =
            |of: &Value| of.as_object().unwrap().keys().cloned().collect::<std::collections::BTreeSet<_>>();
        let done = serde_json::to_value(UploadedDrive::default()).unwrap();
        let result = &schema["$defs"]["map"]["properties"]["result"];
        assert_eq!(printed(&done).into_iter().collect::<Vec<_>>(), described(result));
        assert_eq!(printed(&done), printed(&result["properties"]));
        let served = serde_json::to_value(Publication::default()).unwrap();
        assert_eq!(
            printed(&served).into_iter().collect::<Vec<_>>(),
            described(&result["properties"]["served"])
        );
        for part in ["flaws", "left_out"] {
            let names: Vec<_> = printed(&done[part]).into_iter().collect();
            assert_eq!(names, described(&schema["$defs"][part]), "{part}");
        }
    }
}
