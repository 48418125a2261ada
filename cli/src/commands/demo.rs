//! `echofix demo`: a simulated fleet maps a town, and another vehicle localizes itself on this map.
//!
//! Only the town and its vehicles are simulated. The service runs as its own process, the fleet uploads through the spool of
//! the vehicle library, and the localizing vehicle sends its requests over a socket.

mod report;

use std::fs::File;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use echofix_core::drive::Drive;
use echofix_harness::process::ServiceProcess;
use echofix_harness::questions::QuestionPlan;
use echofix_harness::ranges::within;
use echofix_harness::replay::{ask, patient_localizer};
use echofix_harness::summary::FixSummary;
use echofix_harness::{progress, recording, town, uploading};
use echofix_sim::{City, CityParams, Route};

use super::localize;
use report::Report;

/// Arguments of `echofix demo`.
#[derive(clap::Args)]
pub struct Args {
    /// Seed of the town, its drives and the priors. The same seed gives the same errors.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Vehicles that map the town on the first day.
    #[arg(long, default_value_t = 5, value_parser = within(1..=1000_u64))]
    contributors: u64,
    /// Seconds between the requests of the localizing vehicle.
    #[arg(long, default_value_t = 1.5, value_parser = within(0.05..=86_400.0))]
    every_s: f64,
    /// Write every fix to this CSV file.
    #[arg(long)]
    out: Option<PathBuf>,
    /// End after the report. Otherwise the console stays up until Ctrl-C, on a terminal.
    #[arg(long)]
    exit: bool,
}

/// Days between mapping and localizing: other cars are parked by then.
const DAYS_LATER: u32 = 3;

/// Runs the subcommand.
///
/// # Errors
/// When the service cannot be started or a step of the way fails.
pub async fn run(args: Args, json: bool) -> anyhow::Result<()> {
    let began = Instant::now();
    // What cannot be written is told before half a minute of driving.
    let out = args.out.as_ref().map(|out| localize::writer(out)).transpose()?;
    let folder = tempfile::tempdir().context("making a folder for the demo's map")?;
    let service = ServiceProcess::start(folder.path(), &[]).await?;
    let city = City::generate(&CityParams { seed: args.seed, ..CityParams::default() })?;
    say(
        json,
        &format!(
            "A town with {:.1} km of streets; the service listens at {}.",
            city.streets_m() / 1e3,
            service.grpc
        ),
    );
    say(json, &format!("The console: {}", service.http));
    let mapped = map(&args, &city, &service, folder.path(), json).await?;
    let map = service.folded().await?;
    let summary = localize(&args, &city, &service, (out, json)).await?;
    let report =
        Report { city: &city, args: &args, mapped, map, summary, seconds: began.elapsed().as_secs_f64() };
    report.print(&service, json);
    if !args.exit && !json && std::io::stdout().is_terminal() {
        println!("\nThe console stays up at {} until Ctrl-C.", service.http);
        tokio::signal::ctrl_c().await?;
    }
    service.stop().await
}

fn say(json: bool, text: &str) {
    if !json {
        println!("{text}");
    }
}

/// What the fleet did.
struct Mapped {
    kilometres: f64,
    detections: u64,
    bytes: u64,
    uploads: u64,
}

/// The fleet drives through every street on the first day and uploads what its radars saw.
async fn map(
    args: &Args,
    city: &City,
    service: &ServiceProcess,
    folder: &Path,
    json: bool,
) -> anyhow::Result<Mapped> {
    let bar = progress::bar("the fleet drives and uploads", 0, json);
    let mut mapped = Mapped { kilometres: 0.0, detections: 0, bytes: 0, uploads: 0 };
    let mut vehicles = 0..args.contributors;
    let drive = |vehicle| simulated(city, 0, format!("mapper-{vehicle}"), args.seed * 1000 + vehicle);
    // One vehicle drives while the one before it uploads.
    let mut next = vehicles.next().map(drive);
    while let Some(driving) = next.take() {
        let drive_of_one = driving.await.context("a simulated drive broke down")??;
        next = vehicles.next().map(drive);
        let spool = folder.join(format!("spool-{}", drive_of_one.vehicle));
        let (config, patience) = (recording::to_the_ends(), uploading::PATIENCE);
        let done = uploading::upload(&drive_of_one, &service.grpc, &spool, config, patience, &bar).await?;
        mapped.kilometres += drive_of_one.odometry.travelled_m() / 1e3;
        mapped.detections += done.detections;
        mapped.bytes += done.bytes;
        mapped.uploads += done.uploads;
    }
    bar.finish_and_clear();
    Ok(mapped)
}

/// A drive through every street, simulated off the async threads.
fn simulated(
    city: &City,
    day: u32,
    vehicle: String,
    seed: u64,
) -> tokio::task::JoinHandle<anyhow::Result<Drive>> {
    let params = city.params().clone();
    tokio::task::spawn_blocking(move || {
        let city = City::generate(&params)?;
        Ok(town::drive(&city, day, &Route::survey(&city, seed), vehicle, seed)?)
    })
}

/// Another vehicle drives on another day and asks the service for its pose.
async fn localize(
    args: &Args,
    city: &City,
    service: &ServiceProcess,
    (out, json): (Option<csv::Writer<File>>, bool),
) -> anyhow::Result<FixSummary> {
    let drive = simulated(city, DAYS_LATER, "lost".to_owned(), args.seed * 1000 + 999).await??;
    let plan = QuestionPlan::every(args.every_s, args.seed);
    let bar = progress::bar("another vehicle localizes itself", 0, json);
    let replay = ask(&drive, &patient_localizer(&service.grpc)?, &plan, 2, &bar).await?;
    bar.finish_and_clear();
    if let Some(out) = out {
        localize::write(out, &replay.fixes).context("writing --out")?;
    }
    Ok(replay.summary())
}
