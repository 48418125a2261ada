//! `echofix evaluate`: the paper's experiments, in one process.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use super::about::{About, page, part, shared};
use super::condition::{Condition, Experiment};
use super::crowd::{CrowdSection, Scale};
use super::fleet::options::FleetOptions;
use super::fleet::{self, FleetPlan};
use super::method::{MethodName, Windows};
use super::record::EpochRecord;
use super::run::{EvaluationPlan, run as ask_all};
use super::section::Section;
use super::trust::{self, TrustPlan};
use super::worlds::Worlds;
use super::{crowd, sanity, sections, summary};
use crate::report;
use echofix_harness::progress;
use echofix_harness::ranges::within;
use echofix_sim::Family;

/// Arguments of `echofix evaluate`.
#[derive(clap::Args)]
pub struct Args {
    /// Evaluate few epochs of few worlds, in some minutes, and check that the results are plausible.
    #[arg(long)]
    quick: bool,
    /// Seeds of the simulated towns. A world is one town, or the drive logs given, with its maps and a drive.
    #[arg(long, value_delimiter = ',', default_value = "21,22,23,24,25,26,27,28")]
    world_seeds: Vec<u64>,
    /// Largest number of epochs in a world. At each epoch every method localizes the batch that ends there.
    #[arg(long, default_value_t = 300, value_parser = within(1..=1_000_000_usize))]
    epochs_per_world: usize,
    /// Number of these epochs at which all conditions are evaluated, and not only those of the headline.
    #[arg(long, default_value_t = 60, value_parser = within(1..=1_000_000_usize))]
    swept_per_world: usize,
    /// Time between epochs, seconds of driving. Without it 1; of the drives of --drives the length of a batch.
    #[arg(long, value_parser = within(0.001..=86_400.0))]
    every_s: Option<f64>,
    /// Random priors at each epoch.
    #[arg(long, default_value_t = 1, value_parser = within(1..=100_000_usize))]
    priors: usize,
    /// Seed of the priors and of the odometry's drift.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The experiments to run. Without it: headline to misses in the list below.
    #[arg(long, value_delimiter = ',')]
    only: Vec<Experiment>,
    /// The methods to compare, in the order of the tables.
    #[arg(long, value_delimiter = ',', default_value = "paper,echofix")]
    methods: Vec<MethodName>,
    /// Numbers of contributors to the maps of the experiment `crowd`.
    #[arg(long, value_delimiter = ',', default_value = "1,2,5,10,20", value_parser = within(1..=1000_usize))]
    crowds: Vec<usize>,
    /// Localize this drive log instead of simulated drives. Needs --map.
    #[arg(long, requires = "map", group = "logs")]
    drive: Option<PathBuf>,
    /// Build the map from these drive logs. They are added in this order.
    #[arg(long, value_name = "LOG", num_args = 1.., requires = "logs")]
    map: Vec<PathBuf>,
    /// Organise the batches of the log by its known poses, as the paper did, and not by its odometry.
    #[arg(long, requires = "drive")]
    known_odometry: bool,
    /// Largest standard deviation of a reference pose, metres. Less certain poses add nothing to the map.
    #[arg(long, default_value_t = 0.3, value_parser = within(0.001..=100.0))]
    max_sigma_m: f64,
    /// Memory for prepared map windows, mebibytes.
    #[arg(long, default_value_t = 1024, value_parser = within(1..=1_048_576_u64))]
    windows_mib: u64,
    /// Families of worlds of the experiment `trust`; all of them without it.
    #[arg(long, value_delimiter = ',', value_parser = trust::family)]
    families: Vec<Family>,
    /// Families of worlds to leave out of the experiment `trust`.
    #[arg(long, value_delimiter = ',', value_parser = trust::family)]
    without: Vec<Family>,
    /// Write every fix to this CSV file; of the experiment `trust` and of --drives, every question.
    #[arg(long)]
    epochs: Option<PathBuf>,
    /// Also write tables and figures to docs/benchmarks in the repository at this path. Sections of other experiments stay
    /// as they are.
    #[arg(long, value_name = "FOLDER")]
    write: Option<PathBuf>,
    #[command(flatten)]
    fleet: FleetOptions,
}

/// Runs the subcommand.
///
/// # Errors
/// When a world cannot be made, a file cannot be written, or the results of a quick run are not plausible.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    let (own, experiments): (Vec<_>, Vec<_>) =
        experiments(args).into_iter().partition(|e| Experiment::OF_THE_CROWD.contains(e));
    let own = of_the_crowd(args, &own, json)?;
    let (worlds, plan, crowds) = (worlds(args, !experiments.is_empty()), plan(args), crowds(args));
    let mut conditions = Vec::new();
    for condition in experiments.iter().flat_map(|e| e.conditions(plan.base, &crowds)) {
        if !conditions.contains(&condition) {
            conditions.push(condition);
        }
    }
    let windows = Windows::new(args.windows_mib);
    let bar = progress::bar("epochs", 0, json);
    let mut rows = Vec::new();
    for index in 0..worlds.count() {
        let conditions = worlds.conditions(index, &conditions, plan.base);
        let world = worlds.world(index, &conditions, args.max_sigma_m)?;
        rows.extend(ask_all(&world, &conditions, &plan, &windows, &bar)?);
    }
    bar.finish_and_clear();
    if rows.is_empty() && !experiments.is_empty() {
        bail!(
            "the drives have no epoch at which the vehicle could be localized: they are too short or too slow"
        );
    }
    if let Some(path) = args.epochs.as_ref().filter(|_| !experiments.is_empty()) {
        write_rows(path, &rows).with_context(|| format!("writing {}", path.display()))?;
    }
    let sections = experiments.iter().map(|e| sections::section(*e, &rows, &plan, &crowds));
    let (own, lines): (Vec<_>, Vec<_>) = own.into_iter().map(|report| (report.section, report.lines)).unzip();
    let lines: Vec<_> = own.iter().map(|section| section.experiment).zip(lines).collect();
    let sections: Vec<Section> = sections.chain(own).collect();
    let about = About::of(&worlds, &plan, &rows);
    if let Some(folder) = &args.write {
        write_report(folder, &about, &sections)?;
    }
    if json {
        println!("{}", summary::of(&rows, &experiments, plan.base, &crowds, lines));
    } else {
        println!("{}", page(&about, &sections));
    }
    if args.quick && !experiments.is_empty() {
        sanity::check(&rows, &plan.base)?;
    }
    Ok(())
}

fn of_the_crowd(args: &Args, experiments: &[Experiment], json: bool) -> anyhow::Result<Vec<CrowdSection>> {
    let scale = Scale { towns: args.world_seeds.clone(), quick: args.quick };
    let reports = experiments.iter().map(|experiment| match experiment {
        Experiment::Trust => trust::run(&trust_plan(args, json)?).map(Some),
        Experiment::Drives => fleet::run(&fleet_plan(args, json)).map(Some),
        _ => crowd::run(*experiment, &scale),
    });
    Ok(reports.collect::<anyhow::Result<Vec<_>>>()?.into_iter().flatten().collect())
}

fn trust_plan(args: &Args, json: bool) -> anyhow::Result<TrustPlan> {
    Ok(TrustPlan {
        families: TrustPlan::families(&args.families, &args.without)?,
        seeds: args.world_seeds.clone(),
        quick: args.quick,
        rows: args.epochs.clone(),
        json,
    })
}

/// What `--drives` plans.
pub fn fleet_plan(args: &Args, json: bool) -> FleetPlan {
    FleetPlan {
        drives: args.fleet.drives.clone(),
        map: args.map.clone(),
        questions: args.fleet.questions(args.every_s, args.priors, args.seed),
        risk: args.fleet.integrity_risk,
        alert_limit_m: args.fleet.alert_limit_m,
        max_sigma_m: args.max_sigma_m,
        publish_contributors: args.fleet.publish_contributors,
        windows_mib: args.windows_mib,
        rows: args.epochs.clone(),
        json,
    }
}

fn experiments(args: &Args) -> Vec<Experiment> {
    if !args.fleet.drives.is_empty() {
        return vec![Experiment::Drives];
    }
    let logs = args.drive.is_some();
    let chosen = if args.only.is_empty() { &Experiment::ALL[..] } else { &args.only };
    chosen.iter().copied().filter(|e| !(logs && e.scenes())).collect()
}

fn worlds(args: &Args, any: bool) -> Worlds {
    if !any {
        return Worlds::simulated(&[], &[], args.quick);
    }
    if let Some(drive) = &args.drive {
        return Worlds::Logs { drive: drive.clone(), map: args.map.clone(), known: args.known_odometry };
    }
    let experiments = experiments(args);
    let towns =
        if args.quick { &args.world_seeds[..args.world_seeds.len().min(2)] } else { &args.world_seeds };
    let only_scenes = experiments == [Experiment::Ambiguity];
    let scenes = experiments.iter().any(|e| e.scenes());
    Worlds::simulated(if only_scenes { &[] } else { towns }, if scenes { towns } else { &[] }, args.quick)
}

fn plan(args: &Args) -> EvaluationPlan {
    let (epochs, swept) = if args.quick { (30, 6) } else { (args.epochs_per_world, args.swept_per_world) };
    let base = Condition { contributors: args.map.len().max(1), ..Condition::default() };
    let variants = |experiment: Experiment| {
        let conditions = experiment.conditions(base, &[]);
        conditions.into_iter().flat_map(move |c| experiment.variants().iter().map(move |name| (*name, c)))
    };
    EvaluationPlan {
        every_s: args.every_s.unwrap_or(1.0),
        epochs,
        swept,
        base,
        priors: args.priors,
        seed: args.seed,
        methods: args.methods.clone(),
        variants: experiments(args).into_iter().flat_map(variants).collect(),
        forecasts: true,
    }
}

fn crowds(args: &Args) -> Vec<usize> {
    let logs = args.map.len();
    let most = if args.quick { 2 } else { usize::MAX };
    let possible = |n: &usize| *n >= 1 && *n <= most && (logs == 0 || *n <= logs);
    args.crowds.iter().copied().filter(possible).collect()
}

fn write_rows(path: &Path, rows: &[EpochRecord]) -> anyhow::Result<()> {
    let mut writer = csv::Writer::from_path(path)?;
    for row in rows {
        writer.serialize(row)?;
    }
    Ok(writer.flush()?)
}

/// Writes each section into its page. Sections of other experiments stay as they are.
fn write_report(folder: &Path, about: &About, sections: &[Section]) -> anyhow::Result<()> {
    let pages = report::pages(folder)?;
    let figures = pages.join("figures");
    std::fs::create_dir_all(&figures).with_context(|| format!("making {}", figures.display()))?;
    for section in sections {
        section.draw(&figures)?;
        let (name, part) = part(about, section);
        report::write_section(&pages.join(section.experiment.page()), &name, &part)?;
    }
    let headline = sections.iter().any(|section| section.experiment == Experiment::Headline);
    if about.is_simulated() && headline {
        report::write_section(&pages.join(Experiment::Headline.page()), "evaluate-about", &shared(about))?;
    }
    Ok(())
}
