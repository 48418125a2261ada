//! `echofix localize`: the service, or this machine from tiles of its own, localizes the batches of a drive log.

mod inspect;

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use echofix_core::gate::MAX_RANGE_M;
use echofix_core::odometry::OdometryQuality;
use echofix_harness::credentials::Credentials;
use echofix_harness::fix_record::FixRecord;
use echofix_harness::percentiles::Percentiles;
use echofix_harness::prior::PriorSigma;
use echofix_harness::progress;
use echofix_harness::questions::QuestionPlan;
use echofix_harness::ranges::within;
use echofix_harness::replay::{ask, patient_localizer_to};
use echofix_harness::summary::FixSummary;

use super::ScanRange;
use crate::offline::OfflineLocalizer;

/// Arguments of `echofix localize`.
#[derive(clap::Args)]
pub struct Args {
    /// The drive log: an .mcap file or a folder of CSV files.
    drive: PathBuf,
    /// URL of the service's gRPC port. Without it, that of the profile, or `http://127.0.0.1:50051`.
    #[arg(long, env = "ECHOFIX_SERVER")]
    server: Option<String>,
    /// Localize on this machine, against the tiles in this folder (`echofix tiles sync`). No service is asked then, whatever
    /// --server or `ECHOFIX_SERVER` says.
    #[arg(long)]
    offline: Option<PathBuf>,
    /// Use only these scans of the log, counted from 1, like 10-18.
    #[arg(long)]
    scans: Option<ScanRange>,
    /// Seconds between requests; 0 sends one at every scan.
    #[arg(long, default_value_t = 1.0, value_parser = within(0.0..=86_400.0))]
    every_s: f64,
    /// Length of a batch, seconds.
    #[arg(long, default_value_t = 5.0, value_parser = within(0.0..=60.0))]
    batch_s: f64,
    /// Seconds from the first scan to the first request.
    #[arg(long, default_value_t = 5.0, value_parser = within(0.0..=86_400.0))]
    warm_up_s: f64,
    /// Requests for each batch, each with another random prior around the known pose.
    #[arg(long, default_value_t = 1, value_parser = within(1..=100_000_usize))]
    priors: usize,
    /// Standard deviation of the priors' position along each axis, metres.
    #[arg(long, default_value_t = 2.0, value_parser = within(0.001..=1000.0))]
    sigma_position_m: f64,
    /// Standard deviation of the priors' heading, degrees.
    #[arg(long, default_value_t = 3.0, value_parser = within(0.001..=180.0))]
    sigma_yaw_deg: f64,
    /// Seed of the random priors.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Largest range of a detection, metres. Farther ones are dropped. The service has its own limit, `radar.max_range_m`.
    #[arg(long, default_value_t = MAX_RANGE_M, value_parser = within(1.0..=1000.0))]
    max_range_m: f64,
    /// Standard deviation of the odometry's velocity over a batch, metres per second.
    #[arg(long, default_value_t = OdometryQuality::default().velocity_mps, value_parser = within(0.0..=10.0))]
    odometry_sigma_mps: f64,
    /// Standard deviation of the odometry's yaw rate over a batch, degrees per second.
    #[arg(
        long,
        default_value_t = OdometryQuality::default().yaw_rate_radps.to_degrees(),
        value_parser = within(0.0..=57.0)
    )]
    odometry_sigma_degps: f64,
    /// Requests that wait for their fixes at the same time.
    #[arg(long, default_value_t = 2, value_parser = within(1..=1000_usize))]
    at_once: usize,
    /// Write every fix to this CSV file.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Ask only this question, counted from 1, and draw it into --out (.html or .svg): the batch over the map at the answer, what
    /// else could be meant, the protection ellipse and the verdict's reasons. Needs --offline.
    #[arg(long, requires_all = ["offline", "out"], value_parser = within(1..=1_000_000_usize))]
    inspect: Option<usize>,
    /// End with exit code 1 if a smaller fraction of the answers is usable, 0 to 1.
    #[arg(long, value_parser = within(0.0..=1.0))]
    fail_under: Option<f64>,
}

/// Runs the subcommand.
///
/// # Errors
/// When the log cannot be read, the truth is not known, the service is out of reach, no question is answered, or fewer answers
/// than asked for are usable.
pub async fn run(args: Args, credentials: &Credentials, json: bool) -> anyhow::Result<()> {
    let (drive, mut flaws) = super::drive_of(&args.drive, args.scans.as_ref())?;
    let plan = QuestionPlan {
        every_s: args.every_s,
        batch_s: args.batch_s,
        priors: args.priors,
        sigma: PriorSigma { position_m: args.sigma_position_m, yaw_rad: args.sigma_yaw_deg.to_radians() },
        seed: args.seed,
        warm_up_s: args.warm_up_s,
        max_range_m: args.max_range_m,
        odometry: OdometryQuality {
            velocity_mps: args.odometry_sigma_mps,
            velocity_fraction: 0.0,
            yaw_rate_radps: args.odometry_sigma_degps.to_radians(),
        },
    };
    if let (Some(number), Some(tiles), Some(out)) = (args.inspect, &args.offline, &args.out) {
        inspect::check(out)?;
        let told = inspect::run(&drive, tiles, &plan, number, out).await?;
        if json {
            println!("{}", serde_json::json!({ "out": out, "title": told, "flaws": flaws }));
        } else {
            super::tell(&flaws);
            println!("{told}; see {}", out.display());
        }
        return Ok(());
    }
    // What cannot be written is told before an hour of questions.
    let out = args.out.as_ref().map(|out| Ok::<_, anyhow::Error>((out, writer(out)?))).transpose()?;
    let bar = progress::bar("localizing", 0, json);
    let replay = if let Some(tiles) = &args.offline {
        ask(&drive, &OfflineLocalizer::open(tiles)?, &plan, args.at_once, &bar).await?
    } else {
        let credentials = credentials.clone().resolved()?;
        let service = credentials.endpoint(credentials.server(args.server.as_deref()))?;
        let localizer = patient_localizer_to(service);
        ask(&drive, &localizer, &plan, args.at_once, &bar).await?
    };
    bar.finish_and_clear();
    if let Some((out, writer)) = out {
        write(writer, &replay.fixes).with_context(|| format!("writing {}", out.display()))?;
    }
    let summary = replay.summary();
    flaws.add(replay.flaws);
    if json {
        let findings = replay.findings;
        println!(
            "{}",
            serde_json::json!({ "summary": summary, "fixes": replay.fixes, "findings": findings, "flaws": flaws })
        );
    } else {
        print_fixes(&replay.fixes);
        print_summary(&summary);
        for finding in &replay.findings {
            println!("suspicious: {finding}");
        }
        flaws.lines().for_each(|line| println!("{line}"));
    }
    // Scripts read the exit code.
    let answered = replay.fixes.iter().any(|fix| fix.latitude_deg.is_some());
    ensure!(answered, "none of {} questions was answered", summary.asked);
    let (usable, least) = (summary.usable_share, args.fail_under.unwrap_or(0.0));
    ensure!(
        usable >= least,
        "{:.1} % of the answers are usable, less than {:.1} %",
        1e2 * usable,
        1e2 * least
    );
    Ok(())
}

/// A CSV file to write fixes to.
///
/// # Errors
/// When it cannot be made.
pub fn writer(out: &Path) -> anyhow::Result<csv::Writer<File>> {
    csv::Writer::from_path(out).with_context(|| format!("writing {}", out.display()))
}

/// Writes fixes into a CSV file.
///
/// # Errors
/// When it cannot be written.
pub fn write(mut writer: csv::Writer<File>, fixes: &[FixRecord]) -> anyhow::Result<()> {
    for fix in fixes {
        writer.serialize(fix)?;
    }
    Ok(writer.flush()?)
}

/// At most this many fixes are printed; the rest goes to `--out`.
const PRINTED: usize = 20;

fn print_fixes(fixes: &[FixRecord]) {
    for fix in fixes.iter().take(PRINTED) {
        let seconds = fix.time_us as f64 * 1e-6;
        match (fix.error_m(), fix.error_yaw_deg) {
            (Some(error), Some(yaw)) => {
                println!("{seconds:.2}  {:<22} error {error:6.2} m {yaw:6.2} deg", fix.outcome);
            }
            _ => println!("{seconds:.2}  {:<22} {}", fix.outcome, fix.detail),
        }
    }
    if fixes.len() > PRINTED {
        println!("... and {} more; --out FILE.csv keeps them all", fixes.len() - PRINTED);
    }
}

/// Prints the figures of a replay.
pub fn print_summary(summary: &FixSummary) {
    let outcomes: Vec<_> = summary.outcomes.iter().map(|(word, n)| format!("{word} {n}")).collect();
    println!("{} questions: {}", summary.asked, outcomes.join(", "));
    if !summary.not_asked.is_empty() {
        let reasons: Vec<_> = summary.not_asked.iter().map(|(word, n)| format!("{word} {n}")).collect();
        println!("not asked: {}", reasons.join(", "));
    }
    println!("the vehicle left out: {}", summary.left_out);
    let row = |name: &str, p: Option<Percentiles>, digits: usize| {
        if let Some(Percentiles { p50, p95, p99 }) = p {
            println!("{name:<34} 50 % {p50:8.digits$}   95 % {p95:8.digits$}   99 % {p99:8.digits$}");
        }
    };
    row("error of usable answers, m", summary.error_m, 3);
    row("heading error of usable ones, deg", summary.error_yaw_deg, 3);
    row("error of all answers, m", summary.error_all_m, 3);
    row("heading error of all, deg", summary.error_yaw_all_deg, 3);
    println!(
        "beyond a protection level           {} of the usable answers: along, across or of the heading",
        summary.beyond_protection
    );
    if let (Some(along), Some(cross), Some(yaw)) = (summary.nees_along, summary.nees_cross, summary.nees_yaw)
    {
        println!(
            "NEES of usable answers (1 is honest) along {along:.2}   across {cross:.2}   heading {yaw:.2}"
        );
    }
    row("ms on the server", summary.server_ms, 1);
    row("kB a request", summary.request_kb, 1);
}
