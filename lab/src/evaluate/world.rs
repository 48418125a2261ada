//! A world: maps of one day, a drive of another day, and its truth.

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

/// Maps of one day, and a drive of another day to localize on them.
pub struct EvaluationWorld {
    /// Its number in the run.
    pub index: usize,
    /// The kind of site: a town, one of the scenes, or a drive log.
    pub site_kind: &'static str,
    /// Its name, which contains the seed or the log's path.
    pub name: String,
    /// The drive that is localized.
    pub drive: Drive,
    /// The odometry that organises its batches.
    pub odometry: Trajectory,
    /// Its true poses: map metres, radians from grid east.
    pub truth: Trajectory,
    /// The poses of its own positioning, against which the paper measures errors; may be empty.
    pub reference: Trajectory,
    /// Map metres a ground metre.
    pub scale: f64,
    /// The maps' own error.
    pub floor: Floor,
    maps: BTreeMap<(usize, Movers), RadarMap>,
}

/// Drives before they become a world.
pub struct Drives {
    /// The kind of site: a town, one of the scenes, or a drive log.
    pub site_kind: &'static str,
    /// The world's name.
    pub name: String,
    /// The drives that the maps are made of, in this order.
    pub mapping: Vec<Drive>,
    /// The drive that is localized.
    pub localized: Drive,
}

impl EvaluationWorld {
    /// The world with a map of the first so many drives for each of `crowds`.
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

    /// The world of a drive and existing maps.
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
    /// When the world was made without this map.
    pub fn map(&self, contributors: usize, movers: Movers) -> anyhow::Result<&RadarMap> {
        self.maps
            .get(&(contributors, movers))
            .with_context(|| format!("world {} has no map of {contributors} contributors", self.name))
    }
}

/// The first of the poses that answers are compared with, and all of them.
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

/// The map of each of `crowds` contributors. Without movers, the uploads of several contributors are vetted and moved onto the
/// map, as the service does.
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
