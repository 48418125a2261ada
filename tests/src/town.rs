//! A town of two blocks, and drives in it.

use echofix_core::drive::Drive;
use echofix_core::geo::LatLon;
use echofix_core::time::DAY_US;
use echofix_sim::{City, CityParams, DriveParams, Route, simulate};

/// Day 0 of the town: 2026-01-01.
const FIRST_DAY: i64 = 20_454;

/// The seed of everything random: the same each time, unless `ECHOFIX_TEST_SEED` says otherwise. It is
/// printed, which shows when the test fails.
pub fn seed() -> u64 {
    let chosen = std::env::var("ECHOFIX_TEST_SEED").ok();
    let seed = chosen.map_or(7, |text| text.parse().expect("ECHOFIX_TEST_SEED is a whole number"));
    eprintln!("seed {seed} (ECHOFIX_TEST_SEED={seed} repeats this run)");
    seed
}

/// The town, in Austin.
pub fn town(seed: u64) -> City {
    town_at(seed, CityParams::default().origin)
}

/// The town, elsewhere.
pub fn town_at(seed: u64, origin: LatLon) -> City {
    let params = CityParams { seed, origin, blocks_x: 2, blocks_y: 1, ..CityParams::default() };
    City::generate(&params).expect("the town's parameters are in range")
}

/// A drive through every street of the town.
pub fn survey(city: &City, day: u32, vehicle: &str, seed: u64) -> Drive {
    drive(city, day, vehicle, seed, &Route::survey(city, seed))
}

/// A drive of some length at random.
pub fn wander(city: &City, day: u32, vehicle: &str, seed: u64, length_m: f64) -> Drive {
    drive(city, day, vehicle, seed, &Route::wander(city, seed, length_m))
}

/// A drive along a route.
pub fn drive(city: &City, day: u32, vehicle: &str, seed: u64, route: &Route) -> Drive {
    // Nine in the morning.
    let start_time_us = (FIRST_DAY + i64::from(day)) * DAY_US + 9 * 3_600_000_000;
    let params = DriveParams { vehicle: vehicle.to_owned(), seed, start_time_us, ..DriveParams::default() };
    simulate(&city.on_day(day), route, &params).expect("the drive's parameters are in range")
}
