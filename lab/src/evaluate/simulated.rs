//! Simulated worlds: a town or a scene, mapped on one day and driven again on another.

use echofix_core::drive::Drive;
use echofix_core::time::DAY_US;
use echofix_sim::{City, DriveParams, OdometryModel, Route, Scene, downtown, simulate};
use rayon::prelude::*;

use super::world::Drives;

/// The site kind of towns.
pub const TOWN: &str = "town";
/// Days from the mapping drives to the localized one: from Thursday to Sunday, as in the paper.
const DAYS_LATER: u32 = 3;

/// Whether a site kind is one of the scenes.
pub fn is_scene(site_kind: &str) -> bool {
    Scene::ALL.iter().any(|scene| scene.name() == site_kind)
}

/// Drives in the town of a seed: of `contributors` on day 0, and of another vehicle days later.
///
/// The other vehicle takes the route of the first contributor, as the paper's did.
///
/// # Errors
/// When a parameter is out of range.
pub fn town(seed: u64, contributors: usize) -> anyhow::Result<Drives> {
    let city = City::generate(&downtown::city(seed))?;
    drives(&city, TOWN, seed, contributors)
}

/// Drives in a scene, of one contributor and of another vehicle days later.
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

/// A drive on a day, counted from 0. Its odometry has no errors.
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
