//! Drives in a small town on many days.

use echofix_core::drive::Drive;
use echofix_core::time::DAY_US;
use echofix_sim::city::Plot;
use echofix_sim::{City, CityParams, Route, downtown};

use crate::evaluate::simulated;

/// Length of an errand's route, metres: a few minutes of driving.
const WAY_M: f64 = 900.0;

/// A town of four blocks, with the parameters of the larger towns.
///
/// # Errors
/// When a parameter is out of range.
pub fn small(seed: u64) -> anyhow::Result<City> {
    let params = CityParams { blocks_x: 2, blocks_y: 2, ..downtown::city(seed) };
    Ok(City::generate(&params)?)
}

/// The middle 34 m of a side of a street.
pub fn plot(city: &City, street: usize, left: bool) -> Plot {
    let middle_m = 0.5 * city.network().streets()[street].length_m();
    Plot { street, left, along_m: middle_m - 17.0..middle_m + 17.0 }
}

/// The route of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// Through every street.
    Survey,
    /// A random route.
    Errand,
}

/// A drive on a day of the simulation. Drives with different numbers differ.
///
/// # Errors
/// When a parameter is out of range.
pub fn drive(city: &City, day: u32, way: Way, number: u64) -> anyhow::Result<Drive> {
    let seed = city.params().seed * 100_000 + number;
    let route = match way {
        Way::Survey => Route::survey(city, seed),
        Way::Errand => Route::wander(city, seed, WAY_M),
    };
    simulated::drive(city, day, &route, seed)
}

/// A day of the simulation, counted from the Unix epoch.
pub fn utc_day(day: u32) -> u16 {
    let first = downtown::drive().start_time_us.div_euclid(DAY_US);
    u16::try_from(first + i64::from(day)).unwrap_or(u16::MAX)
}
