//! `echofix demo`: a fleet builds a radar map of a town, and other vehicles find themselves in it.
//!
//! Everything is real but the town: the service runs as its own process, the fleet uploads through
//! the vehicle library's spool, the localizing vehicle asks over a socket.

use std::io::IsTerminal;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use echofix_client::upload::Config as RecorderConfig;
use echofix_core::drive::Drive;
use echofix_sim::{City, CityParams, Route};
use serde_json::Value;
use tokio::process::{Child, Command};

use super::{localize, simulate, status};
use crate::fixes::{self, Plan, Summary};
use crate::statistics::{PAPER_95, Percentiles};
use crate::{contribute, progress};

/// Arguments of `echofix demo`.
#[derive(clap::Args)]
pub struct Args {
    /// Seed of the town and all that drives in it.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Vehicles that map the town on the first day.
    #[arg(long, default_value_t = 5)]
    contributors: u64,
    /// Seconds between the localizing vehicle's questions.
    #[arg(long, default_value_t = 1.5)]
    every_s: f64,
    /// End when done, instead of keeping the console up until Ctrl-C.
    #[arg(long)]
    exit: bool,
}

/// Days between mapping and localizing: the parked cars have changed.
const DAYS_LATER: u32 = 3;

/// Runs the subcommand.
///
/// # Errors
/// When the service cannot be started or a step of the way fails.
pub async fn run(args: Args, json: bool) -> anyhow::Result<()> {
    let began = Instant::now();
    let folder = tempfile::tempdir().context("making a folder for the demo's map")?;
    let service = Service::start(folder.path()).await?;
    let city = City::generate(&CityParams { seed: args.seed, ..CityParams::default() })?;
    say(json, &format!("A town with {:.1} km of streets; the service listens at {}.", city.streets_m() / 1e3, service.grpc));
    say(json, &format!("The console: {}", service.http));
    let mapped = map(&args, &city, &service, folder.path(), json).await?;
    let map = settled(&service.http).await?;
    let summary = localize(&args, &city, &service, json).await?;
    let report = Report { city: &city, args: &args, mapped, map, summary, seconds: began.elapsed().as_secs_f64() };
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
    uploads: u64,
}

/// The fleet drives through every street on the first day and uploads what its radars saw.
async fn map(args: &Args, city: &City, service: &Service, folder: &Path, json: bool) -> anyhow::Result<Mapped> {
    let bar = progress::bar("the fleet drives and uploads", 0, json);
    let mut mapped = Mapped { kilometres: 0.0, detections: 0, uploads: 0 };
    let mut vehicles = 0..args.contributors;
    let drive = |vehicle| simulated(city, 0, format!("mapper-{vehicle}"), args.seed * 1000 + vehicle);
    // One vehicle drives while the one before it uploads.
    let mut next = vehicles.next().map(drive);
    while let Some(driving) = next.take() {
        let drive_of_one = driving.await.context("a simulated drive broke down")??;
        next = vehicles.next().map(drive);
        let spool = folder.join(format!("spool-{}", drive_of_one.vehicle));
        let done =
            contribute::upload(&drive_of_one, &service.grpc, &spool, RecorderConfig::default(), &bar).await?;
        mapped.kilometres += drive_of_one.odometry.travelled_m() / 1e3;
        mapped.detections += done.detections;
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
        simulate::drive(&city, day, &Route::survey(&city, seed), vehicle, seed)
    })
}

/// Waits until the map shows everything that was uploaded, and returns its figures.
async fn settled(http: &str) -> anyhow::Result<Value> {
    let deadline = Instant::now() + Duration::from_secs(120);
    loop {
        let http = http.to_owned();
        let map = tokio::task::spawn_blocking(move || status::get(&http, "/api/v1/map")).await??;
        if map["epoch"] == map["journaled"] {
            return Ok(map);
        }
        if Instant::now() > deadline {
            bail!("the service has not folded the uploads into its map within two minutes: {map}");
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// Another vehicle drives on another day and asks where it is.
async fn localize(args: &Args, city: &City, service: &Service, json: bool) -> anyhow::Result<Summary> {
    let drive = simulated(city, DAYS_LATER, "lost".to_owned(), args.seed * 1000 + 999).await??;
    let plan = Plan {
        every_s: args.every_s,
        batch_s: 5.0,
        priors: 1,
        sigma_position_m: 2.0,
        sigma_yaw_rad: 3_f64.to_radians(),
        seed: args.seed,
        warm_up_s: 5.0,
        at_once: 2,
    };
    let bar = progress::bar("another vehicle finds itself", 0, json);
    let replay = fixes::ask(&drive, &localize::localizer(&service.grpc)?, &plan, &bar).await?;
    bar.finish_and_clear();
    Ok(replay.summary())
}

struct Report<'a> {
    city: &'a City,
    args: &'a Args,
    mapped: Mapped,
    map: Value,
    summary: Summary,
    seconds: f64,
}

impl Report<'_> {
    fn print(&self, service: &Service, json: bool) {
        let street_km = self.city.streets_m() / 1e3;
        let map_kb_per_km = self.map["bytes"].as_f64().unwrap_or(f64::NAN) / 1e3 / street_km;
        if json {
            let report = serde_json::json!({
                "seed": self.args.seed, "contributors": self.args.contributors, "street_km": street_km,
                "driven_km": self.mapped.kilometres, "detections": self.mapped.detections,
                "uploads": self.mapped.uploads, "map": self.map, "map_kb_per_km": map_kb_per_km,
                "localizing": self.summary, "seconds": self.seconds, "console": service.http,
            });
            println!("{report}");
            return;
        }
        let Mapped { kilometres, detections, uploads } = &self.mapped;
        println!(
            "\n{} vehicles drove {kilometres:.1} km and sent {detections} detections in {uploads} uploads.",
            self.args.contributors
        );
        println!("Three days later, with other cars parked, another vehicle asked from priors of sigma 2 m and 3 deg:\n");
        table(&self.summary);
        println!("\nmap                  {map_kb_per_km:8.0} kB a street km, {} tiles", self.map["tiles"]);
        println!("time                 {:8.0} s in all, town seed {}", self.seconds, self.args.seed);
        println!("console              {}", service.http);
    }
}

/// The figures beside the paper's.
fn table(summary: &Summary) {
    let row = |name: &str, unit: &str, p: Option<Percentiles>, scale: f64, paper: String| {
        if let Some(Percentiles { p50, p95, p99 }) = p {
            let [p50, p95, p99] = [p50, p95, p99].map(|v| v * scale);
            println!("{name:<20} {unit:<4} {p50:8.2} {p95:8.2} {p99:8.2}   {paper}");
        }
    };
    println!("{:<25} {:>8} {:>8} {:>8}   {}", "", "50 %", "95 %", "99 %", "the paper's 95 %");
    let (paper_m, paper_deg) = PAPER_95;
    row("horizontal error", "cm", summary.error_all_m, 100.0, format!("{:.0} cm", paper_m * 100.0));
    row("heading error", "deg", summary.error_yaw_all_deg, 1.0, format!("{paper_deg} deg"));
    row("  of usable answers", "cm", summary.error_m, 100.0, String::new());
    row("  of usable answers", "deg", summary.error_yaw_deg, 1.0, String::new());
    row("a fix on the server", "ms", summary.server_ms, 1.0, String::new());
    row("a fix on the wire", "kB", summary.request_kb, 1.0, String::new());
    let usable = summary.usable_share * 100.0;
    println!("\nanswers              {:8} asked, {usable:.1} % usable: {:?}", summary.asked, summary.outcomes);
    println!("beyond protection    {:8} of the usable answers", summary.beyond_protection);
    println!("not asked            {:?} (standing: radar at rest is mostly clutter)", summary.not_asked);
}

/// The service as a process of its own.
struct Service {
    process: Child,
    grpc: String,
    http: String,
}

impl Service {
    async fn start(folder: &Path) -> anyhow::Result<Self> {
        let addresses = folder.join("addresses.json");
        let process = Command::new(std::env::current_exe()?)
            .arg("serve")
            .args(["--grpc-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0", "--data-dir"])
            .arg(folder.join("data"))
            .arg("--addr-file")
            .arg(&addresses)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(folder.join("service.log"))?)
            .kill_on_drop(true)
            .spawn()
            .context("starting the service")?;
        let mut service = Self { process, grpc: String::new(), http: String::new() };
        service.listen(&addresses, folder).await?;
        Ok(service)
    }

    /// Waits for the addresses the service writes once it listens.
    async fn listen(&mut self, addresses: &Path, folder: &Path) -> anyhow::Result<()> {
        let deadline = Instant::now() + Duration::from_secs(30);
        loop {
            if let Ok(text) = std::fs::read_to_string(addresses)
                && let Ok(bound) = serde_json::from_str::<Value>(&text)
                && let (Some(grpc), Some(http)) = (bound["grpc"].as_str(), bound["http"].as_str())
            {
                (self.grpc, self.http) = (format!("http://{grpc}"), format!("http://{http}"));
                return Ok(());
            }
            if self.process.try_wait()?.is_some() || Instant::now() > deadline {
                let log = std::fs::read_to_string(folder.join("service.log")).unwrap_or_default();
                bail!("the service did not start:\n{log}");
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    async fn stop(mut self) -> anyhow::Result<()> {
        self.process.kill().await.context("stopping the service")
    }
}
