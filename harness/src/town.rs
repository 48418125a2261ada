//! Drives in a simulated town, at nine in the morning of a day.

use echofix_core::drive::Drive;
use echofix_core::time::DAY_US;
use echofix_sim::{City, DriveParams, Error, Route, simulate};

/// Day 0 of the town, counted from the Unix epoch: 2026-01-01.
const FIRST_DAY: i64 = 20_454;

/// Nine in the morning of a day of the town, microseconds since the Unix epoch.
#[must_use]
pub fn morning_us(day: u32) -> i64 {
    (FIRST_DAY + i64::from(day)) * DAY_US + 9 * 3_600_000_000
}

/// The drive of a vehicle along a route, in the morning of a day.
///
/// # Errors
/// When the simulation's parameters are out of range.
pub fn drive(city: &City, day: u32, route: &Route, vehicle: String, seed: u64) -> Result<Drive, Error> {
    let params = DriveParams { vehicle, seed, start_time_us: morning_us(day), ..DriveParams::default() };
    simulate(&city.on_day(day), route, &params)
}
