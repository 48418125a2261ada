//! Worlds of drive logs instead of simulated drives.

use std::path::{Path, PathBuf};

use anyhow::Context;
use echofix_client::drivelog::{self, DriveLog};
use echofix_core::drive::Drive;
use echofix_core::geo::Grid;
use echofix_core::odometry::Trajectory;

use super::map::on_grid;
use super::world::Drives;

/// The site kind of drive logs.
pub const LOG: &str = "log";

/// A drive log to localize, and the logs that its map is made of.
///
/// With `known_odometry`, batches are organised by the drive's known poses, as the paper did.
///
/// # Errors
/// When a log cannot be read or holds no known poses.
pub fn drives(localized: &Path, mapping: &[PathBuf], known_odometry: bool) -> anyhow::Result<Drives> {
    let mut drive = read(localized)?;
    if known_odometry {
        drive.odometry = of_known_poses(&drive)?;
    }
    Ok(Drives {
        site_kind: LOG,
        name: localized.display().to_string(),
        mapping: mapping.iter().map(|path| read(path)).collect::<anyhow::Result<_>>()?,
        localized: drive,
    })
}

/// Reads a log, and tells what of it cannot be used.
///
/// # Errors
/// When nothing of it can be used.
pub fn read(path: &Path) -> anyhow::Result<Drive> {
    let DriveLog { drive, flaws } =
        drivelog::read(path).with_context(|| format!("reading {}", path.display()))?;
    if !flaws.is_empty() {
        eprintln!("{}: {flaws}", path.display());
    }
    Ok(drive)
}

/// The known poses as odometry: ground metres from the first pose.
fn of_known_poses(drive: &Drive) -> anyhow::Result<Trajectory> {
    let poses = if drive.truth.is_empty() { &drive.reference } else { &drive.truth };
    let first = poses.first().context("the drive holds no known poses to organise batches by")?;
    let grid = Grid::of(first.at)?;
    let (known, scale) = (on_grid(&grid, poses)?, grid.scale_factor(first.at)?);
    let start = known.first().context("the drive holds no known poses to organise batches by")?.1;
    let mut odometry = Trajectory::default();
    for (time_us, pose) in known.iter() {
        let mut step = start.between(&pose);
        (step.x_m, step.y_m) = (step.x_m / scale, step.y_m / scale);
        odometry.push(time_us, step)?;
    }
    Ok(odometry)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::condition::Condition;
    use crate::evaluate::epoch::epochs;
    use crate::evaluate::map::Movers;
    use crate::evaluate::world::EvaluationWorld;
    use echofix_sim::{City, CityParams, DriveParams, Route, simulate};

    #[test]
    fn logs_make_a_world() {
        let folder = tempfile::tempdir().unwrap();
        let city = City::generate(&CityParams::default()).unwrap();
        let route = Route::wander(&city, 3, 150.0);
        let path = |day: u32| folder.path().join(format!("day-{day}.mcap"));
        for day in [0, 3] {
            let params = DriveParams { seed: u64::from(day), ..DriveParams::default() };
            let drive = simulate(&city.on_day(day), &route, &params).unwrap();
            drivelog::write(path(day), &drive).unwrap();
        }
        let drives = drives(&path(3), &[path(0)], true).unwrap();
        let exact = drives.localized.odometry.clone();
        let world = EvaluationWorld::new(0, drives, &[1], 0.3).unwrap();
        assert!(world.map(1, Movers::Excluded).is_ok() && world.map(2, Movers::Included).is_err());
        assert!(epochs(&world, 1.0, 100, 5).len() > 5);
        let (first, last) = (exact.first().unwrap(), exact.last().unwrap());
        let truth = |t| world.truth.at(t).unwrap();
        let driven_m = truth(first.0).distance_m(&truth(last.0)) / world.scale;
        assert!((first.1.distance_m(&last.1) - driven_m).abs() < 1e-6);
        assert_eq!(Condition::default().contributors, 1);
    }
}
