//! `echofix evaluate`: the paper's experiments, in one process.

use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::evaluate::condition::Experiment;
use crate::evaluate::method::{Name, Windows};
use crate::evaluate::record::Record;
use crate::evaluate::run::{Plan, run as ask_all};
use crate::evaluate::world::World;
use crate::evaluate::{simulated, tables};
use crate::progress;

/// Arguments of `echofix evaluate`.
#[derive(clap::Args)]
pub struct Args {
    /// Seeds of the simulated towns.
    #[arg(long, value_delimiter = ',', default_value = "21,22,23,24,25,26,27,28")]
    world_seeds: Vec<u64>,
    /// Epochs of a town, at most.
    #[arg(long, default_value_t = 300)]
    epochs_per_world: usize,
    /// Of those, epochs at which every condition is asked, not the headline's alone.
    #[arg(long, default_value_t = 100)]
    swept_per_world: usize,
    /// Seconds of driving between epochs.
    #[arg(long, default_value_t = 1.0)]
    every_s: f64,
    /// Priors drawn an epoch.
    #[arg(long, default_value_t = 1)]
    priors: usize,
    /// Seed of priors and drift.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only these experiments.
    #[arg(long, value_delimiter = ',')]
    only: Vec<Experiment>,
    /// The methods, in the order of the tables.
    #[arg(long, value_delimiter = ',', default_value = "paper,echofix")]
    methods: Vec<Name>,
    /// Contributors of the crowd experiment's maps.
    #[arg(long, value_delimiter = ',', default_value = "1,2,5,10,20")]
    crowds: Vec<usize>,
    /// Memory for prepared windows, mebibytes.
    #[arg(long, default_value_t = 1024)]
    windows_mib: u64,
    /// Write every fix to this CSV file.
    #[arg(long)]
    epochs: Option<PathBuf>,
}

/// Reference poses with a larger sigma are not mapped from, metres.
const MAX_SIGMA_M: f64 = 0.3;

/// Runs the subcommand.
///
/// # Errors
/// When a world cannot be made or a file not be written.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    let experiments = if args.only.is_empty() { Experiment::ALL.to_vec() } else { args.only.clone() };
    let mut conditions = Vec::new();
    for condition in experiments.iter().flat_map(|e| e.conditions(&args.crowds)) {
        if !conditions.contains(&condition) {
            conditions.push(condition);
        }
    }
    let crowds: Vec<usize> = conditions.iter().map(|c| c.contributors).collect();
    let most = crowds.iter().copied().max().unwrap_or(1);
    let plan = Plan {
        every_s: args.every_s,
        epochs: args.epochs_per_world,
        swept: args.swept_per_world,
        priors: args.priors,
        seed: args.seed,
        methods: args.methods.clone(),
    };
    let windows = Windows::new(args.windows_mib);
    let bar = progress::bar("epochs", 0, json);
    let mut rows = Vec::new();
    for (index, seed) in args.world_seeds.iter().enumerate() {
        let drives = simulated::town(*seed, most)?;
        let world = World::new(index, format!("town {seed}"), drives, &crowds, MAX_SIGMA_M)?;
        rows.extend(ask_all(&world, &conditions, &plan, &windows, &bar)?);
    }
    bar.finish_and_clear();
    if let Some(path) = &args.epochs {
        write(path, &rows).with_context(|| format!("writing {}", path.display()))?;
    }
    let all: Vec<&Record> = rows.iter().collect();
    let groups: tables::Groups<'_> = tables::methods(&all)
        .into_iter()
        .map(|name| (name.to_owned(), tables::of_method(&all, name)))
        .collect();
    println!("{}", tables::errors(&groups));
    println!("{}", tables::integrity(&groups));
    println!("{}", tables::covariance(&groups));
    println!("{}", tables::costs(&groups));
    Ok(())
}

fn write(path: &Path, rows: &[Record]) -> anyhow::Result<()> {
    let mut writer = csv::Writer::from_path(path)?;
    for row in rows {
        writer.serialize(row)?;
    }
    Ok(writer.flush()?)
}
