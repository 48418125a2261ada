//! `echofix bench`: what a fix costs on this machine, from the socket to the engine.
//!
//! - [`command`]: the arguments.
//! - [`town`]: a town that vehicles map by their uploads, and the requests of another vehicle in it.
//! - [`load`]: clients that send requests over real sockets.
//! - [`cold`]: a street for which the service has prepared no tiles yet.
//! - [`inside`]: the service's parts in this process, step by step.
//! - [`case`]: one alignment. [`engines`] and [`sizes`] time it engine by engine, and by the size of window and batch.
//! - [`lengths`]: a request by the length of its batch.
//! - [`lost`]: the cost and the success of relocalization.
//! - [`stress`]: a fix beside all else, and more than the service can do.
//! - [`waits`]: what people wait for.
//! - [`mod@page`]: the figures as a page.
//!
//! The service is a process of its own, so that its processor time and memory do not contain those of the clients.

mod case;
mod cold;
pub mod command;
mod engines;
mod inside;
mod lengths;
mod load;
mod lost;
mod page;
mod sizes;
mod stress;
mod town;
mod waits;

use std::path::Path;
use std::time::Duration;

use anyhow::ensure;
use serde::Serialize;

use crate::machine::Machine;
use cold::Cold;
use echofix_harness::fix_record::FixRecord;
use echofix_harness::percentiles::Percentiles;
use echofix_harness::process::ServiceProcess;
use engines::EngineTiming;
use inside::Inside;
use lengths::Length;
use load::Load;
use lost::Lost;
pub(crate) use page::head;
use page::page;
use sizes::Size;
use town::{BenchTown, UploadCost};

/// How much is measured, and in what town.
#[derive(Debug, Clone, Serialize)]
struct BenchPlan {
    /// Seed of the town, the drives and the priors.
    pub seed: u64,
    /// Blocks of the town, from west to east and from south to north.
    pub blocks: (usize, usize),
    /// Number of vehicles that map it.
    pub contributors: u64,
    /// Largest number of requests, one for each second of driving. Under load they are sent again and again.
    pub questions: usize,
    /// How long each load lasts, seconds.
    pub load_s: f64,
    /// Number of clients for each compute thread of the service.
    pub clients_per_thread: usize,
    /// How many times each step and each engine is timed.
    pub repetitions: usize,
    /// Half widths of the searches in which the engines are compared, metres.
    pub half_widths_m: Vec<f64>,
    /// Occupied cells of the batches on which they are compared.
    pub cells: Vec<usize>,
    /// Number of batches of each size.
    pub sized: usize,
    /// Number of requests of lost vehicles.
    pub lost: usize,
    /// Uploads of the history that is looked at with `--waits`.
    pub history: u64,
}

impl BenchPlan {
    /// The full measurement, in some minutes.
    pub fn full(seed: u64) -> Self {
        let blocks = (3, 2);
        Self {
            seed,
            blocks,
            contributors: 2,
            questions: 60,
            load_s: 10.0,
            clients_per_thread: 4,
            repetitions: 20,
            half_widths_m: vec![6.0, 12.0, 30.0],
            cells: vec![8_000, 20_000, 50_000, 100_000],
            sized: 3,
            lost: 120,
            history: 100_000,
        }
    }

    /// A small measurement, which shows whether the benchmark works, and not what a fix costs.
    pub fn quick(seed: u64) -> Self {
        let blocks = (2, 1);
        Self {
            seed,
            blocks,
            contributors: 1,
            questions: 20,
            load_s: 2.0,
            clients_per_thread: 2,
            repetitions: 2,
            half_widths_m: vec![6.0],
            cells: vec![8_000, 50_000],
            sized: 1,
            lost: 6,
            history: 1_000,
        }
    }
}

/// The figures that were measured.
#[derive(Debug, Clone, Serialize)]
struct Figures {
    /// How much was measured, and in what town.
    pub plan: BenchPlan,
    /// The machine.
    pub machine: Machine,
    /// Kilometres of the town's streets.
    pub street_km: f64,
    /// Detections of the median request.
    pub detections: usize,
    /// What the uploads of the map cost.
    pub uploads: UploadCost,
    /// A street for which no tiles were prepared yet.
    pub cold: Cold,
    /// The service under load, by the number of its compute threads.
    pub loads: Vec<Load>,
    /// The same requests, refused before the alignment: what all else costs.
    pub refused: Load,
    /// How long each step of a request takes, in this process.
    pub inside: Inside,
    /// The search and the whole fix, by engine.
    pub engines: Vec<EngineTiming>,
    /// The search by the size of window and batch.
    pub sizes: Vec<Size>,
    /// A request by the length of its batch.
    pub lengths: Vec<Length>,
    /// Relocalization.
    pub lost: Lost,
    /// Horizontal errors of all answers, metres.
    pub error_m: Option<Percentiles>,
    /// Fraction of the answers that are usable.
    pub usable_share: f64,
}

/// Numbers of compute threads of the service under load.
const THREADS: [usize; 2] = [1, 2];
/// More detections than any batch has: the service refuses every request after it has organised it.
const NEVER_ENOUGH: &str = "locating.min_detections=1000000";

/// Measures, with the map in this folder.
///
/// # Errors
/// When a step fails, or the fixes are so bad that their cost means nothing.
async fn run(plan: BenchPlan, folder: &Path, say: &impl Fn(&str)) -> anyhow::Result<Figures> {
    say("A town is mapped.");
    let town = BenchTown::mapped(&plan, folder).await?;
    say(&format!("{} questions; a street for the first time.", town.recording.count()));
    let (mut loads, mut fixes) = (Vec::new(), Vec::new());
    let cold = cold::measure(&town, folder).await?;
    for threads in THREADS {
        say(&format!("Load on {threads} compute thread(s)."));
        let (load, answered) = loaded(&plan, &town, folder, threads, &[]).await?;
        loads.push(load);
        fixes.extend(answered);
    }
    say("Load without alignment.");
    let (refused, _) = loaded(&plan, &town, folder, 2, &[NEVER_ENOUGH.to_owned()]).await?;
    say("Steps and engines, in process.");
    let parts = inside::InProcessService::open(&town, folder)?;
    let inside = parts.profile(parts.requests(), plan.repetitions).await?;
    let engines = engines::measure(&parts.cases()?, plan.repetitions)?;
    say("Windows and batches of other sizes.");
    let sizes = sizes::measure(&parts, &plan)?;
    let lengths = lengths::measure(&parts, &town, plan.repetitions).await?;
    say("Vehicles that are lost.");
    let lost = lost::measure(&parts, &town, plan.lost, plan.seed)?;
    let (error_m, usable_share) = sane(&fixes)?;
    Ok(Figures {
        machine: Machine::here(),
        street_km: town.street_km,
        uploads: town.uploads,
        detections: inside::detections(parts.requests()),
        plan,
        cold,
        loads,
        refused,
        inside,
        engines,
        sizes,
        lengths,
        lost,
        error_m,
        usable_share,
    })
}

/// Starts a service of so many compute threads, fills its caches and puts it under load.
async fn loaded(
    plan: &BenchPlan,
    town: &BenchTown,
    folder: &Path,
    threads: usize,
    settings: &[String],
) -> anyhow::Result<(Load, Vec<FixRecord>)> {
    let mut settings = settings.to_vec();
    settings.push(format!("locating.threads={threads}"));
    settings.extend([cold::ROOM, town::TRUSTING].map(str::to_owned));
    let service = ServiceProcess::start(folder, &settings).await?;
    let clients = threads * plan.clients_per_thread;
    load::once(&service, &town.recording).await?;
    let span = Duration::from_secs_f64(plan.load_s);
    let (load, answers) = load::closed_loop(&service, &town.recording, clients, threads, span).await?;
    service.stop().await?;
    let fix = |(index, answer, ms): load::Answered| FixRecord::of(&town.recording, index, answer, ms);
    Ok((load, answers.into_iter().map(fix).collect()))
}

/// The errors of the fixes and the fraction that is usable. Fixes that no working service would give are an error: their
/// cost would mean nothing.
fn sane(fixes: &[FixRecord]) -> anyhow::Result<(Option<Percentiles>, f64)> {
    let answered: Vec<f64> = fixes.iter().filter_map(FixRecord::error_m).collect();
    ensure!(
        answered.len() == fixes.len(),
        "{} of {} questions got no pose",
        fixes.len() - answered.len(),
        fixes.len()
    );
    let usable = fixes.iter().filter(|fix| fix.usable).count() as f64 / fixes.len().max(1) as f64;
    ensure!(usable > 0.5, "only {:.0} % of the answers are usable", usable * 100.0);
    let errors = Percentiles::of(fixes.iter().filter(|fix| fix.usable).filter_map(FixRecord::error_m));
    let worst = errors.map_or(f64::INFINITY, |errors| errors.p95);
    ensure!(worst < 0.6, "the usable answers err by {worst:.2} m at 95 %");
    Ok((Percentiles::of(answered), usable))
}
