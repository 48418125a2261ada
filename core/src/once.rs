//! One alignment from plain points, for those who have no store and no service.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::align::engine::Engine;
use crate::align::verdict::Integrity;
use crate::align::weights::TileWeights;
use crate::align::{Aligner, Alignment, EngineKind, Prior, Search, Task};
use crate::batch::{self, Batch};
use crate::evidence::{Cell, OFFSET_STEPS, presence};
use crate::gate::{Dropped, Gate};
use crate::geo::{CELL_M, CellIndex, TILE_M, TileId, Zone};
use crate::odometry::Trajectory;
use crate::point::MapPoint;
use crate::scan::{self, Mount, Scan};
use crate::tile::Tile;
use crate::window::MapSquare;

/// Any zone: map metres are those of the caller's plane.
const PLANE_EPSG: u32 = 32631;
/// Coordinates beyond this are no map metres, metres.
const PLANE_M: f64 = 1e8;
/// The widest search, metres in each direction: a window of 300 m takes 9 MB, and the time grows with its area.
pub const WIDEST_SEARCH_M: f64 = 100.0;

/// What a vehicle saw, and how it moved meanwhile.
#[derive(Debug, Clone, Copy)]
pub struct VehicleScans<'a> {
    /// Scans of some seconds; their sensors are indices into the mounts.
    pub scans: &'a [Scan],
    /// Where the radars sit on the body.
    pub mounts: &'a [Mount],
    /// The body's trajectory over these seconds, in any frame that does not move.
    pub odometry: &'a Trajectory,
}

/// How to align.
#[derive(Clone, Copy)]
pub struct OnceOptions<'a> {
    /// Which detections are used. The default drops those of a standing vehicle.
    pub gate: Gate,
    /// How to search.
    pub search: Search,
    /// What the answer must pass.
    pub integrity: Integrity,
    /// What searches.
    pub engine: &'a dyn Engine,
}

impl Default for OnceOptions<'_> {
    fn default() -> Self {
        Self {
            gate: Gate::default(),
            search: Search::default(),
            integrity: Integrity::default(),
            engine: EngineKind::default().engine(),
        }
    }
}

/// Why nothing was aligned, and what to do about it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A map point is no position.
    #[error("map point {index} is [{x_m}, {y_m}]; give map metres, finite and below 1e8")]
    MapPoint {
        /// Its index.
        index: usize,
        /// Its first coordinate.
        x_m: f64,
        /// Its second coordinate.
        y_m: f64,
    },
    /// The map has nothing around the prior.
    #[error(
        "no map point lies within {reach_m:.0} m of the prior; give both in the same map metres, or a prior on the map"
    )]
    NoMapAroundPrior {
        /// How far was looked, metres along each axis.
        reach_m: f64,
    },
    /// The prior's pose is no pose on the map.
    #[error("the prior's pose is not finite map metres and radians; give a rough pose on the map")]
    PriorPose,
    /// The prior's sigmas or its scale are no positive numbers.
    #[error(
        "the prior's `{field}` is {value}; give a positive number (for `scale`, 1.0 where map metres are ground metres)"
    )]
    PriorNotPositive {
        /// The offending field.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// The prior is so vague that the search would take too long.
    #[error(
        "the search would reach {search_m:.0} m from the prior, at most {WIDEST_SEARCH_M:.0} m are searched; give a prior with a smaller `sigma_position_m`"
    )]
    SearchTooWide {
        /// Sigmas times the prior's sigma, metres.
        search_m: f64,
    },
    /// There are no scans.
    #[error("there is no scan; give the scans of some seconds, five are usual")]
    NoScans,
    /// A scan's columns cannot be used.
    #[error("scan {index}: {source}")]
    Scan {
        /// Its index.
        index: usize,
        /// What is wrong with it.
        source: scan::Error,
    },
    /// The scans do not form a batch.
    #[error("{0}; give a mount for each sensor, and odometry from before the first scan to after the last")]
    Batch(#[from] batch::Error),
    /// The gate left nothing.
    #[error(
        "the gate left none of {detections} detections ({} too slow, {} too far, {} movers, {} without odometry); loosen `OnceOptions::gate` or give scans of a moving vehicle",
        dropped.too_slow, dropped.too_far, dropped.moving, dropped.without_pose
    )]
    NoDetections {
        /// Detections that were given.
        detections: u64,
        /// Why they were dropped.
        dropped: Dropped,
    },
}

/// Aligns scans with a map that is given as points, around a prior: the pose of the body at the
/// time of the newest scan, with its errors and whether it may be used.
///
/// The map is prepared anew each time. Who asks more than once keeps [`TileWeights`] and an [`Aligner`].
///
/// # Errors
/// When there is nothing to align; the error says what to change. A pose that is doubtful is no error but a
/// verdict: see [`Alignment::verdict`].
pub fn align_once(
    map_points: &[MapPoint],
    seen: &VehicleScans<'_>,
    prior: &Prior,
    options: &OnceOptions<'_>,
) -> Result<Alignment, Error> {
    let OnceOptions { gate, search, integrity, engine } = options;
    let search_m = checked_search_m(prior, search)?;
    let batch = batch(seen, gate)?;
    let Ok(zone) = Zone::from_epsg(PLANE_EPSG) else { unreachable!("{PLANE_EPSG} is a zone of UTM") };
    let position = MapPoint::of(&prior.pose);
    let square = MapSquare::around(zone, position, search.extent_m, search_m);
    // A tile's weights take in the hits of its neighbours.
    let reach_m = 0.5 * square.side as f64 * CELL_M + 2.0 * TILE_M;
    let tiles = tiles_of(zone, map_points, position, reach_m)?;
    let known = square.tiles().filter(|id| tiles.contains_key(id));
    let weights: Vec<_> = known.map(|id| Arc::new(TileWeights::new(id, |at| tiles.get(&at)))).collect();
    if weights.is_empty() {
        return Err(Error::NoMapAroundPrior { reach_m: search.extent_m + search_m });
    }
    let task = Task { square, tiles: &weights, batch: &batch, prior };
    Ok(Aligner::default().align(&task, *engine, search, integrity))
}

/// How far the search reaches, metres, once the prior was found to be one.
fn checked_search_m(prior: &Prior, search: &Search) -> Result<f64, Error> {
    let Prior { pose, sigma_position_m, sigma_yaw_rad, scale } = *prior;
    if !pose.is_finite() || pose.x_m.abs().max(pose.y_m.abs()) > PLANE_M {
        return Err(Error::PriorPose);
    }
    for (field, value) in
        [("sigma_position_m", sigma_position_m), ("sigma_yaw_rad", sigma_yaw_rad), ("scale", scale)]
    {
        if !(value > 0.0 && value.is_finite()) {
            return Err(Error::PriorNotPositive { field, value });
        }
    }
    let search_m = search.sigmas * sigma_position_m;
    if search_m > WIDEST_SEARCH_M { Err(Error::SearchTooWide { search_m }) } else { Ok(search_m) }
}

fn batch(seen: &VehicleScans<'_>, gate: &Gate) -> Result<Batch, Error> {
    let VehicleScans { scans, mounts, odometry } = *seen;
    let newest_us = scans.iter().map(|scan| scan.time_us).max().ok_or(Error::NoScans)?;
    for (index, scan) in scans.iter().enumerate() {
        scan.validate().map_err(|source| Error::Scan { index, source })?;
    }
    let batch = Batch::organise(scans, mounts, odometry, newest_us, gate)?;
    if batch.points.is_empty() {
        return Err(Error::NoDetections { detections: batch.detections, dropped: batch.dropped });
    }
    Ok(batch)
}

/// The map's tiles around a position, as one survey would have made them.
pub(crate) fn tiles_of(
    zone: Zone,
    points: &[MapPoint],
    position: MapPoint,
    reach_m: f64,
) -> Result<BTreeMap<TileId, Tile>, Error> {
    let mut cells: BTreeMap<TileId, BTreeMap<u32, Cell>> = BTreeMap::new();
    for (index, point) in points.iter().enumerate() {
        let MapPoint { x_m, y_m } = *point;
        if !(x_m.abs() < PLANE_M && y_m.abs() < PLANE_M) {
            return Err(Error::MapPoint { index, x_m, y_m });
        }
        if (x_m - position.x_m).abs().max((y_m - position.y_m).abs()) > reach_m {
            continue;
        }
        let at = CellIndex::of(*point);
        let (id, index) = TileId::locate(zone, at);
        let once = Cell { passes: 1, contributors: 1, presence: presence::ALWAYS, ..Cell::default() };
        let cell = cells.entry(id).or_default().entry(index).or_insert(once);
        cell.hits += 1;
        for (axis, (along, corner)) in [(x_m, at.x), (y_m, at.y)].into_iter().enumerate() {
            let steps = (along / CELL_M - corner as f64) * f64::from(OFFSET_STEPS);
            cell.offset_sum[axis] += (steps as u32).min(OFFSET_STEPS - 1);
        }
    }
    let tile = |cells: BTreeMap<u32, Cell>| Tile::from_cells(cells.into_iter().collect()).unwrap_or_default();
    Ok(cells.into_iter().map(|(id, cells)| (id, tile(cells))).collect())
}

#[cfg(test)]
mod tests;
