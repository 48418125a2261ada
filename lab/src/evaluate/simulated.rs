//! Simulated worlds: a town or a single street, mapped on one day and driven again on another.

use echofix_core::drive::Drive;
use echofix_core::time::DAY_US;
use echofix_sim::{City, DriveParams, OdometryModel, Route, Scene, downtown, simulate};
use rayon::prelude::*;

use super::world::Drives;

/// What kind of site a town is.
pub const TOWN: &str = "town";
/// Days from the mapping drives to the localized one: from Thursday to Sunday, as in the paper.
const DAYS_LATER: u32 = 3;

/// Is it one of the streets made to be mistaken?
pub fn is_scene(site_kind: &str) -> bool {
    Scene::ALL.iter().any(|scene| scene.name() == site_kind)
}

/// A town of a seed, driven through by `contributors` on day 0 and by another vehicle days later.
///
/// The other vehicle takes the first contributor's way, as the paper's did.
///
/// # Errors
/// When a parameter is out of range.
pub fn town(seed: u64, contributors: usize) -> anyhow::Result<Drives> {
    let city = City::generate(&downtown::city(seed))?;
    drives(&city, TOWN, seed, contributors)
}

/// A street that is made to be mistaken, in the same way.
///
/// # Errors
/// When a parameter is out of range.
pub fn scene(scene: Scene, seed: u64) -> anyhow::Result<Drives> {
    drives(&scene.city(seed)?, scene.name(), seed, 1)
}

fn drives(city: &City, site_kind: &'static str, seed: u64, contributors: usize) -> anyhow::Result<Drives> {
    let number = |vehicle: usize| seed * 1000 + vehicle as u64;
    let mapping = (0..contributors)
        .into_par_iter()
        .map(|vehicle| drive(city, 0, &Route::survey(city, number(vehicle)), number(vehicle)))
        .collect::<anyhow::Result<_>>()?;
    let localized = drive(city, DAYS_LATER, &Route::survey(city, number(0)), number(999))?;
    Ok(Drives { site_kind, name: format!("{site_kind} {seed}"), mapping, localized })
}

/// A drive on a day, counted from the first; its odometry is left without errors.
///
/// # Errors
/// When a parameter is out of range.
pub fn drive(city: &City, day: u32, route: &Route, seed: u64) -> anyhow::Result<Drive> {
    let base = downtown::drive();
    let params = DriveParams {
        vehicle: format!("vehicle-{seed}"),
        seed,
        start_time_us: base.start_time_us + i64::from(day) * DAY_US,
        odometry: OdometryModel::Perfect,
        ..base
    };
    Ok(simulate(&city.on_day(day), route, &params)?)
}
