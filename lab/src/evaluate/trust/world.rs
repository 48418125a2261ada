//! A family's world: its maps as the service makes them, its vehicle, and the truth.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use anyhow::Context;
use echofix_core::align::weights::TileWeights;
use echofix_core::drive::Drive;
use echofix_core::geo::{Grid, TileId};
use echofix_core::odometry::Trajectory;
use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;
use echofix_core::tile::Tile;
use echofix_core::window::MapSquare;
use echofix_sim::family::{Contribution, FamilyWorld};

use crate::evaluate::crowd::map::CrowdMap;
use crate::evaluate::crowd::uploads::{SentForm, cut};
use crate::evaluate::map::on_grid;

/// A served map, with the tiles that were asked for prepared.
pub struct ServedMap {
    tiles: BTreeMap<TileId, Tile>,
    prepared: HashMap<TileId, Arc<TileWeights>>,
}

impl ServedMap {
    /// The prepared tiles of a square.
    pub fn weights(&mut self, square: MapSquare) -> Vec<Arc<TileWeights>> {
        let Self { tiles, prepared } = self;
        let known = square.tiles().filter(|id| tiles.contains_key(id));
        let prepare = |id: TileId| Arc::new(TileWeights::packed(id, |at| tiles.get(&at)));
        known.map(|id| Arc::clone(prepared.entry(id).or_insert_with(|| prepare(id)))).collect()
    }
}

/// A drive that asks, with its truth on the grid.
pub struct AskingDrive {
    /// The drive.
    pub drive: Drive,
    /// Its true poses: map metres, radians from grid east.
    pub truth: Trajectory,
}

impl AskingDrive {
    fn new(drive: Drive, grid: &Grid) -> anyhow::Result<Self> {
        Ok(Self { truth: on_grid(grid, &drive.truth)?, drive })
    }

    /// The true pose half-way.
    fn half_way(&self) -> Option<Pose2> {
        let half_m = 0.5 * self.truth.travelled_m();
        let (mut way_m, mut before) = (0.0, self.truth.first()?.1);
        for (_, pose) in self.truth.iter() {
            way_m += before.distance_m(&pose);
            before = pose;
            if way_m >= half_m {
                return Some(pose);
            }
        }
        None
    }
}

/// A world that is asked.
pub struct TrustWorld {
    /// The grid of its map.
    pub grid: Grid,
    /// Map metres a ground metre.
    pub scale: f64,
    /// The vehicle.
    pub asking: AskingDrive,
    /// A vehicle in another world of the family: nobody mapped its streets.
    pub stranger: AskingDrive,
    /// The map.
    pub map: ServedMap,
    /// The map of those who turned back half-way along the vehicle's route.
    pub ending: ServedMap,
    /// Where they turned back.
    pub end: Pose2,
    /// True poses in mapped streets.
    pub known: Vec<Pose2>,
}

/// A pose in mapped streets is taken every so many.
const KNOWN_EVERY: usize = 20;
/// Half width of the street in which contributors turn back, metres.
const STREET_M: f64 = 30.0;
/// How far beyond the end the map has gone, metres.
const BEYOND_M: f64 = 200.0;

impl TrustWorld {
    /// Simulates and maps a world.
    ///
    /// # Errors
    /// When a drive cannot be simulated or mapped from.
    pub fn new(world: &FamilyWorld) -> anyhow::Result<Self> {
        let asking = world.asking()?;
        let first = asking.truth.first().context("the drive that asks has no truth")?;
        let grid = Grid::of(first.at)?;
        let scale = grid.scale_factor(first.at)?;
        let asking = AskingDrive::new(asking, &grid)?;
        let stranger = world.family.world(world.seed + 50_000)?.asking()?;
        let stranger = AskingDrive::new(stranger, &grid)?;
        let end = asking.half_way().context("the drive that asks does not move")?;
        let number = 0..world.contributors;
        let contributions: Vec<_> =
            number.map(|number| world.contribution(number)).collect::<Result<_, _>>()?;
        let mut known = Vec::new();
        for drive in contributions.iter().flat_map(|c| &c.drives) {
            known.extend(on_grid(&grid, &drive.truth)?.iter().map(|(_, pose)| pose).step_by(KNOWN_EVERY));
        }
        let map = mapped(&contributions, &grid, world.range.publish, None)?;
        let ending = mapped(&contributions, &grid, world.range.publish, Some(&end))?;
        Ok(Self { grid, scale, asking, stranger, map, ending, end, known })
    }
}

/// The map that is served with these contributions, without what was driven beyond an end.
fn mapped(
    contributions: &[Contribution],
    grid: &Grid,
    publish: u8,
    end: Option<&Pose2>,
) -> anyhow::Result<ServedMap> {
    let mut map = CrowdMap::new(grid.zone());
    for Contribution { contributor, drives } in contributions {
        for drive in drives {
            let turned_back = end.map(|end| until(drive, grid, end)).transpose()?;
            let drive = turned_back.as_ref().unwrap_or(drive);
            for upload in cut(drive, grid.zone(), SentForm::of(*contributor))? {
                map.offer(&upload);
            }
        }
    }
    Ok(ServedMap { tiles: map.published(publish, None), prepared: HashMap::new() })
}

/// Is a pose in the same street beyond an end?
pub fn is_beyond(end: &Pose2, pose: &Pose2) -> bool {
    let [x, y] = end.inverse().transform([pose.x_m, pose.y_m]);
    (0.0..BEYOND_M).contains(&x) && y.abs() < STREET_M
}

/// The part of a drive that is not beyond an end.
fn until(drive: &Drive, grid: &Grid, end: &Pose2) -> anyhow::Result<Drive> {
    let truth = on_grid(grid, &drive.truth)?;
    let kept = |time_us: i64| truth.at(time_us).is_none_or(|pose| !is_beyond(end, &pose));
    let mut drive = drive.clone();
    drive.scans.retain(|scan| kept(scan.time_us));
    drive.reference.retain(|pose| kept(pose.time_us));
    Ok(drive)
}

/// The square of the map that a prior needs.
pub fn square(grid: &Grid, pose: &Pose2, extent_m: f64, reach_m: f64) -> MapSquare {
    MapSquare::around(grid.zone(), MapPoint::of(pose), extent_m, reach_m)
}
