//! `MapService.GetCoverage`: what the map knows along a route.

use std::collections::HashMap;
use std::sync::Arc;

use echofix_core::geo::{CELL_M, CELLS_PER_TILE, Grid, LatLon, TileId, Zone};
use echofix_core::tile::Tile;
use echofix_proto::v1::{GetCoverageRequest, GetCoverageResponse};
use tokio::sync::OwnedSemaphorePermit;
use tonic::Status;

use super::violation::{Violation, require};
use super::{blocking, decode, status};
use crate::store::{self, MapStore};

/// Points of a route, at most.
const MAX_POINTS: usize = 4_096;
/// How far around a point cells count, metres.
const RADIUS_M: f64 = 50.0;
/// Decoded tiles kept for the next points: the neighbourhoods of several.
const TILES_KEPT: usize = 64;

pub(super) async fn get_coverage(
    store: Arc<dyn MapStore>,
    request: GetCoverageRequest,
    place: OwnedSemaphorePermit,
) -> Result<GetCoverageResponse, Status> {
    let route = route(&request).map_err(|violation| status::invalid(&violation))?;
    blocking(move || {
        let _place = place;
        coverage(&*store, &route)
    })
    .await?
}

fn route(request: &GetCoverageRequest) -> Result<Vec<LatLon>, Violation> {
    let GetCoverageRequest { latitude_deg, longitude_deg } = request;
    let rows = latitude_deg.len();
    require(rows <= MAX_POINTS, "latitude_deg", &format!("has more than {MAX_POINTS} values"))?;
    let described = format!("has {} values but `latitude_deg` has {rows}", longitude_deg.len());
    require(longitude_deg.len() == rows, "longitude_deg", &described)?;
    let point =
        |(row, (lat, lon)): (usize, (&f64, &f64))| decode::lat_lon(*lat, *lon, &format!("points[{row}]"));
    latitude_deg.iter().zip(longitude_deg).enumerate().map(point).collect()
}

fn coverage(store: &dyn MapStore, route: &[LatLon]) -> Result<GetCoverageResponse, Status> {
    let epoch = store.progress().borrow().epoch;
    let mut looker = Looker { store, grid: None, tiles: HashMap::new() };
    let mut response = GetCoverageResponse { epoch, ..GetCoverageResponse::default() };
    for at in route {
        // Beyond UTM there is no map, which is what was asked.
        let seen = match Zone::of(*at) {
            Ok(zone) => looker.around(zone, *at).map_err(|error| status::store(&error))?,
            Err(_) => Seen::default(),
        };
        response.cells.push(seen.cells);
        response.newest_day.push(u32::from(seen.newest_day));
    }
    Ok(response)
}

/// What lies around a point.
#[derive(Default)]
struct Seen {
    cells: u32,
    newest_day: u16,
}

struct Looker<'a> {
    store: &'a dyn MapStore,
    grid: Option<Grid>,
    tiles: HashMap<TileId, Option<Arc<Tile>>>,
}

impl Looker<'_> {
    fn around(&mut self, zone: Zone, at: LatLon) -> Result<Seen, store::Error> {
        if self.grid.as_ref().is_none_or(|grid| grid.zone() != zone) {
            self.grid = Grid::new(zone).ok();
        }
        let mut seen = Seen::default();
        let Some(Ok(centre)) = self.grid.as_ref().map(|grid| grid.project(at)) else { return Ok(seen) };
        for id in TileId::covering(zone, centre, RADIUS_M) {
            if let Some(tile) = self.tile(id)? {
                look(&tile, id, centre, &mut seen);
            }
        }
        Ok(seen)
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
fn look(tile: &Tile, id: TileId, [x, y]: [f64; 2], seen: &mut Seen) {
    let ([x0, y0], side) = (id.origin(), CELLS_PER_TILE as u32);
    for (index, cell) in tile.cells() {
        let east = x0 + (f64::from(index % side) + 0.5) * CELL_M - x;
        let north = y0 + (f64::from(index / side) + 0.5) * CELL_M - y;
        if east * east + north * north <= RADIUS_M * RADIUS_M {
            seen.cells += 1;
            seen.newest_day = seen.newest_day.max(cell.last_day);
        }
    }
}
