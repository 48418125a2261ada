//! `echofix simulate`: the drive log of a simulated vehicle.

use std::path::PathBuf;

use anyhow::Context;
use echofix_client::drivelog;
use echofix_core::drive::Drive;
use echofix_core::time::DAY_US;
use echofix_sim::{City, CityParams, DriveParams, Route, simulate};

/// Day 0 of the simulated town: 2026-01-01.
const FIRST_DAY: i64 = 20_454;

/// Arguments of `echofix simulate`.
#[derive(clap::Args)]
pub struct Args {
    /// Where to write the log: a file ending in .mcap, or a folder for CSV.
    out: PathBuf,
    /// Seed of the town; the same seed is the same town.
    #[arg(long, default_value_t = 1)]
    city: u64,
    /// Day: parked cars and traffic change from day to day.
    #[arg(long, default_value_t = 0)]
    day: u32,
    /// Seed of the drive: its way, its noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Name of the vehicle.
    #[arg(long, default_value = "simulated")]
    vehicle: String,
    /// Drive this far at random, metres, instead of once through every street.
    #[arg(long)]
    wander_m: Option<f64>,
}

/// A drive in a simulated town, at nine in the morning of its day.
pub fn drive(city: &City, day: u32, route: &Route, vehicle: String, seed: u64) -> anyhow::Result<Drive> {
    let start_time_us = (FIRST_DAY + i64::from(day)) * DAY_US + 9 * 3_600_000_000;
    let params = DriveParams { vehicle, seed, start_time_us, ..DriveParams::default() };
    Ok(simulate(&city.on_day(day), route, &params)?)
}

/// Runs the subcommand.
///
/// # Errors
/// When the town cannot be made or the log cannot be written.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    let city = City::generate(&CityParams { seed: args.city, ..CityParams::default() })?;
    let route = match args.wander_m {
        Some(length_m) => Route::wander(&city, args.seed, length_m),
        None => Route::survey(&city, args.seed),
    };
    let drive = drive(&city, args.day, &route, args.vehicle.clone(), args.seed)?;
    drivelog::write(&args.out, &drive).with_context(|| format!("writing {}", args.out.display()))?;
    super::import::report(&drive, &args.out, json);
    Ok(())
}
