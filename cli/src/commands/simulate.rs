//! `echofix simulate`: the drive log of a simulated vehicle.

use std::path::PathBuf;

use echofix_harness::ranges::within;
use echofix_harness::town;
use echofix_sim::{City, CityParams, Route};

/// Arguments of `echofix simulate`.
#[derive(clap::Args)]
pub struct Args {
    /// The drive log to write: a file whose name ends in .mcap, or a folder of CSV files.
    out: PathBuf,
    /// Seed of the town. The same seed gives the same town.
    #[arg(long, default_value_t = 1)]
    city: u64,
    /// Day of the drive, counted from 0. Parked cars and traffic change from day to day.
    #[arg(long, default_value_t = 0, value_parser = within(0..=36_500_u32))]
    day: u32,
    /// Seed of the drive: its route and its noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Name of the vehicle.
    #[arg(long, default_value = "simulated")]
    vehicle: String,
    /// Drive a random route of this length, metres. Without it, the route goes once through every street.
    #[arg(long, value_parser = within(1.0..=1e6))]
    wander_m: Option<f64>,
    /// Write over what is there.
    #[arg(long)]
    force: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// When the town cannot be made, something is in the log's place, or the log cannot be written.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    super::keep(&args.out, args.force)?;
    let city = City::generate(&CityParams { seed: args.city, ..CityParams::default() })?;
    let route = match args.wander_m {
        Some(length_m) => Route::wander(&city, args.seed, length_m),
        None => Route::survey(&city, args.seed),
    };
    let drive = town::drive(&city, args.day, &route, args.vehicle.clone(), args.seed)?;
    super::write_drive(&args.out, &drive)?;
    super::import::report(&drive, &args.out, json);
    Ok(())
}
