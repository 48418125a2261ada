//! `echofix sizing`: what a fleet asks of replicas.

use std::path::PathBuf;

use anyhow::ensure;

use super::costs::Costs;
use super::page::page;
use super::wanted::Told;
use super::{Plan, run as simulate};
use crate::report;

/// What can be asked for.
#[derive(clap::Args)]
#[command(after_help = "\
Simulates a day of vehicles on several replicas over one bucket, from measured costs (lab/src/sizing/costs.toml). Prints cores,
memory, requests to the bucket, bytes and dollars, how long fixes take, and what a lost replica, a bucket that is away and a
hot city do.

  echofix sizing
  echofix sizing --vehicles 20000 --road-km 100000 --replicas 3 --cores 16")]
pub struct Args {
    /// Seed of the cities and of the uploads.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Vehicles on the road in the busiest minute; each asks for a fix once a second.
    #[arg(long, default_value_t = 1_000_000)]
    vehicles: u32,
    /// Kilometres of road.
    #[arg(long, default_value_t = 5_000_000)]
    road_km: u32,
    /// Mean speed, km/h.
    #[arg(long, default_value_t = 36.0)]
    speed_kmh: f64,
    /// Number of replicas.
    #[arg(long, default_value_t = 48)]
    replicas: u16,
    /// Cores of each replica.
    #[arg(long, default_value_t = 64)]
    cores: u16,
    /// Memory for prepared tiles (`locating.tile_cache_mib`) of each replica, GiB.
    #[arg(long, default_value_t = 192.0)]
    cache_gib: f64,
    /// Weight of each server in HAProxy.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u16).range(1..=256))]
    weight: u16,
    /// HAProxy's hash-balance-factor, per cent; 0 for none.
    #[arg(long, default_value_t = 150)]
    balance_factor: u16,
    /// How vehicles learn which uploads are wanted.
    #[arg(long, value_enum, default_value_t = Told::Coverage)]
    told: Told,
    /// A file with other costs; see lab/src/sizing/costs.toml.
    #[arg(long, value_name = "FILE")]
    costs: Option<PathBuf>,
    /// Also write the figures to docs/benchmarks/sizing.md in the repository at this path.
    #[arg(long, value_name = "FOLDER")]
    write: Option<PathBuf>,
}

/// Runs the subcommand.
///
/// # Errors
/// When an argument makes no sense, or a file cannot be read or written.
pub fn run(args: Args, json: bool) -> anyhow::Result<()> {
    let costs = Costs::read(args.costs.as_deref())?;
    ensure!(args.vehicles > 0 && args.road_km > 0, "--vehicles and --road-km must be at least 1");
    ensure!(
        (1..=4096).contains(&args.replicas) && args.cores > 0,
        "--replicas must be 1 to 4096, and --cores at least 1"
    );
    ensure!(args.speed_kmh > 1.0 && args.speed_kmh < 300.0, "--speed-kmh must lie between 1 and 300");
    ensure!(args.cache_gib > 0.0 && args.cache_gib < 1e5, "--cache-gib must be above 0 and below 100 000");
    ensure!(args.balance_factor == 0 || args.balance_factor > 100, "--balance-factor must be 0 or above 100");
    let plan = Plan {
        seed: args.seed,
        vehicles: f64::from(args.vehicles),
        road_km: f64::from(args.road_km),
        speed_kmh: args.speed_kmh,
        replicas: usize::from(args.replicas),
        cores: u32::from(args.cores),
        cache_gib: args.cache_gib,
        weight: u32::from(args.weight),
        factor: (args.balance_factor > 0).then(|| f64::from(args.balance_factor) / 100.0),
        told: args.told,
        places: 6,
    };
    let say = |text: &str| {
        if !json {
            eprintln!("{text}");
        }
    };
    let figures = simulate(plan, costs, &say);
    let page = page(&figures);
    if let Some(repository) = args.write {
        report::write_section(&report::pages(&repository)?.join("sizing.md"), "sizing", &page)?;
    }
    if json {
        println!("{}", serde_json::to_string(&figures)?);
    } else {
        println!("{page}");
    }
    Ok(())
}
