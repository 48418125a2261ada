//! A world: maps of one day, a drive on another, and the truth.

use std::collections::BTreeMap;

use anyhow::Context;
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::geo::Grid;
use echofix_core::odometry::Trajectory;
use rayon::prelude::*;

use super::crowd::map::CrowdMap;
use super::crowd::uploads::{self, SentForm};
use super::floor::Floor;
use super::map::{MapKey, Movers, RadarMap, on_grid};

/// Maps of one day and a drive on another.
pub struct EvaluationWorld {
    /// Its number.
    pub index: usize,
    /// What kind of site it is.
    pub site_kind: &'static str,
    /// Its name, with the seed or the log's.
    pub name: String,
    /// The drive that is localized.
    pub drive: Drive,
    /// What organises its batches.
    pub odometry: Trajectory,
    /// Where it really was: map metres, radians from grid east.
    pub truth: Trajectory,
    /// Where its own positioning believed it was, as the paper's errors are measured; may be empty.
    pub reference: Trajectory,
    /// Map metres a ground metre.
    pub scale: f64,
    /// How far off the maps' own poses were.
    pub floor: Floor,
    maps: BTreeMap<(usize, Movers), RadarMap>,
}

/// Drives before they become a world.
pub struct Drives {
    /// What kind of site they are in.
    pub site_kind: &'static str,
    /// Its name.
    pub name: String,
    /// Those that map, by the order in which they join the map.
    pub mapping: Vec<Drive>,
    /// The one that is localized.
    pub localized: Drive,
}

impl EvaluationWorld {
    /// Maps the first so many drives for each of `crowds`, and lays out the truth of the other.
    ///
    /// # Errors
    /// When there is no truth, or a drive cannot be mapped from.
    pub fn new(index: usize, drives: Drives, crowds: &[usize], max_sigma_m: f64) -> anyhow::Result<Self> {
        let Drives { site_kind, name, mapping, localized } = drives;
        let grid = grid_of(&localized)?;
        let both: Vec<_> = [Movers::Included, Movers::Excluded]
            .into_par_iter()
            .map(|movers| {
                let key = MapKey { world: index, contributors: 0, movers };
                grown(RadarMap::new(key, grid.zone()), &mapping, crowds, max_sigma_m)
            })
            .collect::<anyhow::Result<_>>()?;
        let floor = Floor::of(&grid, &mapping)?;
        Self::with_maps(index, (site_kind, name), localized, floor, both.into_iter().flatten())
    }

    /// A drive on maps that are there.
    ///
    /// # Errors
    /// When there is no truth, or it is off the grid.
    pub fn with_maps(
        index: usize,
        (site_kind, name): (&'static str, String),
        drive: Drive,
        floor: Floor,
        maps: impl IntoIterator<Item = RadarMap>,
    ) -> anyhow::Result<Self> {
        let grid = grid_of(&drive)?;
        let (first, poses) = known(&drive)?;
        let maps = maps.into_iter().map(|map| ((map.key.contributors, map.key.movers), map));
        Ok(Self {
            index,
            site_kind,
            name,
            odometry: drive.odometry.clone(),
            truth: on_grid(&grid, poses)?,
            reference: on_grid(&grid, &drive.reference)?,
            scale: grid.scale_factor(first.at)?,
            floor,
            maps: maps.collect(),
            drive,
        })
    }

    /// The map of the first so many contributors.
    ///
    /// # Errors
    /// When it was not asked for.
    pub fn map(&self, contributors: usize, movers: Movers) -> anyhow::Result<&RadarMap> {
        self.maps
            .get(&(contributors, movers))
            .with_context(|| format!("world {} has no map of {contributors} contributors", self.name))
    }
}

/// The poses that answers are compared with, and the first of them.
fn known(drive: &Drive) -> anyhow::Result<(&GeoPose, &[GeoPose])> {
    let poses = if drive.truth.is_empty() { &drive.reference } else { &drive.truth };
    let first =
        poses.first().with_context(|| format!("`{}` has no known poses to compare with", drive.vehicle))?;
    Ok((first, poses))
}

/// The grid of the zone that a drive begins in.
///
/// # Errors
/// When the drive has no known pose, or it is off the grid.
pub fn grid_of(drive: &Drive) -> anyhow::Result<Grid> {
    Ok(Grid::of(known(drive)?.0.at)?)
}

/// The map after each of `crowds` contributors: without movers, more than one are vetted and moved onto each
/// other, as the service does.
fn grown(
    mut map: RadarMap,
    drives: &[Drive],
    crowds: &[usize],
    max_sigma_m: f64,
) -> anyhow::Result<Vec<RadarMap>> {
    let most = crowds.iter().copied().max().unwrap_or(0);
    let mut crowd = (map.key.movers == Movers::Excluded && most > 1).then(|| CrowdMap::new(map.zone()));
    let mut grown_maps = Vec::new();
    for (before, drive) in drives.iter().take(most).enumerate() {
        let (contributor, count) = (before as u64, before + 1);
        if let Some(crowd) = &mut crowd {
            for upload in
                uploads::cut(drive, map.zone(), SentForm { max_sigma_m, ..SentForm::of(contributor) })?
            {
                crowd.offer(&upload);
            }
        }
        if crowd.is_none() || before == 0 {
            map.add(drive, contributor, max_sigma_m)?;
        }
        if crowds.contains(&count) {
            let key = MapKey { contributors: count, ..map.key };
            grown_maps.push(match &crowd {
                Some(crowd) if count > 1 => crowd.whole(key),
                _ => map.grown_from(count),
            });
        }
    }
    Ok(grown_maps)
}
