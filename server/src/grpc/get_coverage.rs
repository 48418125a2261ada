//! `MapService.GetCoverage`: what the map knows along a route.

use std::collections::HashMap;
use std::sync::Arc;

use echofix_core::align::localizability::Expected;
use echofix_core::demand::DemandPolicy;
use echofix_core::geo::{CELL_M, CELLS_PER_TILE, Grid, LatLon, TileId, Zone};
use echofix_core::point::MapPoint;
use echofix_core::pose::{Pose2, wrap_axis};
use echofix_core::tile::Tile;
use echofix_proto::v1::{ExpectedFix, FixStatus, GetCoverageRequest, GetCoverageResponse};
use tokio::runtime::Handle;
use tokio::sync::OwnedSemaphorePermit;
use tonic::Status;

use super::invalid_field::{InvalidField, require};
use super::{attended, decode, status};
use crate::locating::{Expectations, NotAssessed};
use crate::patience::Patience;
use crate::shares::Place;
use crate::store::{self, MapStore};

/// Points of a route, at most.
const MAX_POINTS: usize = 4_096;
/// Points of a route at which fixes are expected, at most: each may take some milliseconds.
const MAX_EXPECTED: usize = 1_024;
/// How far around a point cells count, metres.
const RADIUS_M: f64 = 50.0;
/// Decoded tiles in memory for the next points: the neighbourhoods of several.
const TILES_KEPT: usize = 64;

pub(super) async fn get_coverage(
    (store, expectations, demand): (Arc<dyn MapStore>, Arc<Expectations>, DemandPolicy),
    request: GetCoverageRequest,
    permits: (OwnedSemaphorePermit, (Place, Option<Place>)),
) -> Result<GetCoverageResponse, Status> {
    let route = route(&request).map_err(|violation| status::invalid(&violation))?;
    attended(&Handle::current(), None, move |patience| {
        let _permits = permits;
        let mut response = coverage(&*store, demand, &route, patience)?;
        if request.expectations {
            response.expected = expected(&*store, &expectations, &route, patience)?;
        }
        Ok(response)
    })
    .await
}

fn route(request: &GetCoverageRequest) -> Result<Vec<LatLon>, InvalidField> {
    let GetCoverageRequest { latitude_deg, longitude_deg, expectations } = request;
    let rows = latitude_deg.len();
    let many = format!("has more than {MAX_EXPECTED} values with `expectations`");
    require(!expectations || rows <= MAX_EXPECTED, "latitude_deg", &many)?;
    require(rows <= MAX_POINTS, "latitude_deg", &format!("has more than {MAX_POINTS} values"))?;
    let described = format!("has {} values but `latitude_deg` has {rows}", longitude_deg.len());
    require(longitude_deg.len() == rows, "longitude_deg", &described)?;
    let point = |(row, (lat, lon)): (usize, (&f64, &f64))| {
        decode::lat_lon(*lat, *lon, &format!("latitude_deg[{row}], longitude_deg[{row}]"))
    };
    latitude_deg.iter().zip(longitude_deg).enumerate().map(point).collect()
}

fn coverage(
    store: &dyn MapStore,
    demand: DemandPolicy,
    route: &[LatLon],
    patience: &Patience,
) -> Result<GetCoverageResponse, Status> {
    let epoch = store.progress().borrow().epoch;
    let mut reader = CoverageReader { store, demand, grid: None, tiles: HashMap::new() };
    let contributors_needed = u32::from(store.totals().needed);
    let mut response = GetCoverageResponse { epoch, contributors_needed, ..GetCoverageResponse::default() };
    for at in route {
        if patience.is_over() {
            return Err(status::gone());
        }
        // Beyond UTM there is no map, which is what was asked.
        let seen = match Zone::of(*at) {
            Ok(zone) => reader.around(zone, *at).map_err(|error| status::store(&error))?,
            Err(_) => PointCoverage::default(),
        };
        response.cells.push(seen.cells);
        response.newest_day.push(u32::from(seen.newest_day));
        response.contributors.push(u32::from(seen.waiting));
        response.wanted_from_day.push(u32::from(seen.wanted_from));
    }
    Ok(response)
}

/// What fixes along a route can be expected to be.
fn expected(
    store: &dyn MapStore,
    expectations: &Expectations,
    route: &[LatLon],
    patience: &Patience,
) -> Result<Vec<ExpectedFix>, Status> {
    let unmapped = ExpectedFix { status: FixStatus::TooLittleMap.into(), ..ExpectedFix::default() };
    let fix = |at: &LatLon| Ok(expected_at(store, expectations, *at, patience)?.unwrap_or(unmapped));
    route.iter().map(fix).collect()
}

fn expected_at(
    store: &dyn MapStore,
    expectations: &Expectations,
    at: LatLon,
    patience: &Patience,
) -> Result<Option<ExpectedFix>, Status> {
    let Ok(grid) = Grid::of(at) else { return Ok(None) };
    let Ok(position) = grid.project(at) else { return Ok(None) };
    let id = TileId::of(grid.zone(), position);
    let tile = match expectations.tile(id, patience) {
        Ok(Some(tile)) => tile,
        Ok(None) => return Ok(None),
        Err(NotAssessed::Gone) => return Err(status::gone()),
        Err(NotAssessed::Store(error)) => return Err(status::store(&error)),
    };
    let fix = tile.at(id, position);
    let axis = Pose2::new(position.x_m, position.y_m, fix.weak_direction_rad());
    let Ok((_, direction_rad)) = grid.pose_to_geodetic(&axis) else { return Ok(None) };
    let status = match expectations.verdict(fix) {
        Expected::Usable => FixStatus::Usable,
        Expected::Ambiguous => FixStatus::Ambiguous,
        Expected::TooLittleStructure => FixStatus::TooLittleStructure,
    };
    Ok(Some(ExpectedFix {
        status: status.into(),
        weakest_sigma_m: fix.weakest_m(),
        weakest_direction_rad: wrap_axis(direction_rad),
        strongest_sigma_m: fix.strongest_m(),
        sigma_yaw_rad: fix.sigma_yaw_rad(),
        margin: fix.margin,
        rival_east_m: fix.rival.map(|rival| rival.x_m),
        rival_north_m: fix.rival.map(|rival| rival.y_m),
        version: store.wire_version(tile.version),
    }))
}

/// What lies around a point.
#[derive(Default)]
struct PointCoverage {
    cells: u32,
    newest_day: u16,
    /// The most contributors that have seen what is not served yet, where nothing is.
    waiting: u8,
    /// The day from which on an upload of the tile at the point is wanted.
    wanted_from: u16,
}

struct CoverageReader<'a> {
    store: &'a dyn MapStore,
    demand: DemandPolicy,
    grid: Option<Grid>,
    tiles: HashMap<TileId, Option<Arc<Tile>>>,
}

impl CoverageReader<'_> {
    fn around(&mut self, zone: Zone, at: LatLon) -> Result<PointCoverage, store::Error> {
        if self.grid.as_ref().is_none_or(|grid| grid.zone() != zone) {
            self.grid = Grid::new(zone).ok();
        }
        let mut seen = PointCoverage::default();
        let Some(Ok(centre)) = self.grid.as_ref().map(|grid| grid.project(at)) else { return Ok(seen) };
        for id in TileId::covering(zone, centre, RADIUS_M) {
            if let Some(tile) = self.tile(id)? {
                look(&tile, id, centre, &mut seen);
            }
        }
        let here = self.tile(TileId::of(zone, centre))?;
        seen.wanted_from = self.demand.wanted_from(here.as_deref());
        if seen.cells == 0 {
            seen.waiting = self.waiting(zone, centre)?;
        }
        Ok(seen)
    }

    /// The most contributors that have seen anything of the tiles around a point of which nothing is served yet.
    fn waiting(&self, zone: Zone, centre: MapPoint) -> Result<u8, store::Error> {
        let mut most = 0;
        for id in TileId::covering(zone, centre, RADIUS_M) {
            let withheld = self.store.withheld(zone, id.x..=id.x, id.y..=id.y)?;
            most = most.max(withheld.map_or(0, |withheld| withheld.contributors));
        }
        Ok(most)
    }

    fn tile(&mut self, id: TileId) -> Result<Option<Arc<Tile>>, store::Error> {
        if let Some(tile) = self.tiles.get(&id) {
            return Ok(tile.clone());
        }
        if self.tiles.len() >= TILES_KEPT {
            self.tiles.clear();
        }
        let tile = self.store.tile(id)?.map(|stored| stored.tile);
        self.tiles.insert(id, tile.clone());
        Ok(tile)
    }
}

/// Counts a tile's cells whose centre lies within the radius.
fn look(tile: &Tile, id: TileId, centre: MapPoint, seen: &mut PointCoverage) {
    let (corner, side) = (id.origin(), CELLS_PER_TILE as u32);
    for (index, cell) in tile.cells() {
        let east = corner.x_m + (f64::from(index % side) + 0.5) * CELL_M - centre.x_m;
        let north = corner.y_m + (f64::from(index / side) + 0.5) * CELL_M - centre.y_m;
        if east * east + north * north <= RADIUS_M * RADIUS_M {
            seen.cells += 1;
            seen.newest_day = seen.newest_day.max(cell.last_day);
        }
    }
}

#[cfg(test)]
mod tests;
