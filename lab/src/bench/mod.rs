//! What a fix costs on this machine, from the socket to the engine.
//!
//! - [`town`]: a town, mapped through the vehicles' own uploads, and what another vehicle asks in it.
//! - [`load`]: clients that ask over real sockets, one question after the other.
//! - [`cold`]: a street that the service has not seen yet: windows made, memory taken.
//! - [`inside`]: the same map and requests without sockets: where the time of one request goes.
//! - [`command`]: its arguments.
//! - [`case`]: a batch, the map around its prior, and how to search.
//! - [`engines`]: the alignment alone, by engine.
//! - [`sizes`]: the search by the size of window and batch.
//! - [`lengths`]: one request by the length of its batch.
//! - [`lost`]: the wide search for vehicles that are lost.
//! - [`mod@page`]: the figures as a page.
//!
//! The service is a process of its own: what it used is its own, and not the questioner's.

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
mod town;

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
pub use page::page;
use sizes::Size;
use town::{BenchTown, UploadCost};

/// How much is measured.
#[derive(Debug, Clone, Serialize)]
pub struct BenchPlan {
    /// Seed of the town, the drives and the priors.
    pub seed: u64,
    /// Blocks of the town, east and north.
    pub blocks: (usize, usize),
    /// Vehicles that map it.
    pub contributors: u64,
    /// Questions, one a second of driving; they are asked again and again.
    pub questions: usize,
    /// Seconds of load for each figure.
    pub load_s: f64,
    /// Clients that ask at once, for each compute thread of the service.
    pub clients_per_thread: usize,
    /// Times that each step and each engine is timed.
    pub repetitions: usize,
    /// Windows the engines are compared in: shifts in each direction, metres.
    pub half_widths_m: Vec<f64>,
    /// Occupied cells of the batches they are compared on.
    pub cells: Vec<usize>,
    /// Batches of each size.
    pub sized: usize,
    /// Questions of vehicles that are lost.
    pub lost: usize,
}

impl BenchPlan {
    /// All of it, in some minutes.
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
        }
    }

    /// Little of it: that it works, rather than what it costs.
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
        }
    }
}

/// What was measured.
#[derive(Debug, Clone, Serialize)]
pub struct Figures {
    /// How much was measured.
    pub plan: BenchPlan,
    /// On what.
    pub machine: Machine,
    /// Kilometres of the town's streets.
    pub street_km: f64,
    /// Detections of the median request.
    pub detections: usize,
    /// What the map's uploads cost.
    pub uploads: UploadCost,
    /// A street seen for the first time.
    pub cold: Cold,
    /// Load, by the service's compute threads.
    pub loads: Vec<Load>,
    /// The same questions, refused before they are aligned: what everything else costs.
    pub refused: Load,
    /// Where the time of one request goes, in process.
    pub inside: Inside,
    /// The alignment alone.
    pub engines: Vec<EngineTiming>,
    /// The search by the size of window and batch.
    pub sizes: Vec<Size>,
    /// One request by the length of its batch.
    pub lengths: Vec<Length>,
    /// The wide search.
    pub lost: Lost,
    /// Horizontal errors of all answers, metres.
    pub error_m: Option<Percentiles>,
    /// Fraction of the answers that are usable.
    pub usable_share: f64,
}

/// Compute threads of the service under load.
const THREADS: [usize; 2] = [1, 2];
/// More detections than any batch has: every question is refused once it is organised.
const NEVER_ENOUGH: &str = "locating.min_detections=1000000000";

/// Measures in a folder of its own.
///
/// # Errors
/// When a step of the way fails or the answers are not sane.
pub async fn run(plan: BenchPlan, folder: &Path, say: &impl Fn(&str)) -> anyhow::Result<Figures> {
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
    let scene = inside::InProcessService::open(&town, folder)?;
    let inside = scene.profile(scene.requests(), plan.repetitions).await?;
    let engines = engines::measure(&scene.cases()?, plan.repetitions)?;
    say("Windows and batches of other sizes.");
    let sizes = sizes::measure(&scene, &plan)?;
    let lengths = lengths::measure(&scene, &town, plan.repetitions).await?;
    say("Vehicles that are lost.");
    let lost = lost::measure(&scene, &town, plan.lost, plan.seed)?;
    let (error_m, usable_share) = sane(&fixes)?;
    Ok(Figures {
        machine: Machine::here(),
        street_km: town.street_km,
        uploads: town.uploads,
        detections: inside::detections(scene.requests()),
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

/// A service of so many compute threads, warmed and put under load.
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

/// Answers that no working service would give are an error: figures for them would mean nothing.
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
