//! The whole map from far away: blocks of 16 x 16 tiles.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use echofix_core::geo::{Grid, LatLon, TILE_M, TileId, Zone};
use echofix_core::point::MapPoint;

use super::view::mercator;
use super::{Spot, View};
use crate::http::error::Error;
use crate::store::{MapStore, TileInfo};

/// Tiles that UTM has room for, east and north of a zone's false origin.
const EVERY_X: RangeInclusive<i32> = 0..=(1_000_000.0 / TILE_M) as i32;
const EVERY_Y: RangeInclusive<i32> = 0..=(10_000_000.0 / TILE_M) as i32;
/// log2 of the tiles along a block's side.
const SHIFT: u32 = 4;
/// Occupied cells of a block that shine brightest: a few dozen tiles of city.
const FULL: f64 = 200_000.0;

/// The whole map in blocks.
#[derive(Default)]
pub struct Overview {
    /// Epoch of the map it was made from.
    pub epoch: u64,
    /// Tiles by zone.
    pub zones: Vec<(Zone, u64)>,
    blocks: Vec<OverviewBlock>,
}

/// Some neighbouring tiles.
struct OverviewBlock {
    /// West, south, east, north.
    bounds: [f64; 4],
    /// The north-west and the south-east corner on the Mercator square.
    corners: [[f64; 2]; 2],
    cells: u32,
    version: u64,
    day: u16,
}

/// Tiles of a block while it is gathered.
struct Gathered {
    low: [i32; 2],
    high: [i32; 2],
    cells: u32,
    version: u64,
    day: u16,
}

impl Overview {
    /// Makes it from the catalog.
    ///
    /// # Errors
    /// When the store refuses.
    pub fn of(store: &dyn MapStore) -> Result<Self, Error> {
        // Before the catalog is read: what changes meanwhile belongs to a later epoch and is seen then.
        let epoch = store.progress().borrow().epoch;
        let mut overview = Self { epoch, ..Self::default() };
        for zone in store.zones() {
            let catalog = store.catalog(zone, EVERY_X, EVERY_Y)?;
            overview.zones.push((zone, catalog.len() as u64));
            let grid = Grid::new(zone)?;
            for gathered in gather(&catalog).values() {
                overview.blocks.extend(gathered.placed(&grid)?);
            }
        }
        Ok(overview)
    }

    /// West, south, east, north of all that is mapped.
    pub fn bounds(&self) -> Option<[f64; 4]> {
        let join =
            |a: [f64; 4], b: [f64; 4]| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])];
        self.blocks.iter().map(|b| b.bounds).reduce(join)
    }

    /// Longitude and latitude of the block with most evidence: where there is something to see.
    pub fn center(&self) -> Option<[f64; 2]> {
        let [w, s, e, n] = self.blocks.iter().max_by_key(|b| b.cells)?.bounds;
        Some([f64::midpoint(w, e), f64::midpoint(s, n)])
    }

    /// What a view shows, as (rectangle of pixels it touches, version, spot).
    pub fn seen_in(&self, view: &View) -> impl Iterator<Item = (Rectangle, u64, Spot)> {
        self.blocks.iter().filter_map(move |block| {
            let rectangle = Rectangle::touched(view, block.corners)?;
            Some((rectangle, block.version, Spot::of_count(block.cells, FULL, block.day)))
        })
    }
}

/// Tiles by block.
fn gather(catalog: &[TileInfo]) -> BTreeMap<[i32; 2], Gathered> {
    let mut blocks = BTreeMap::new();
    for tile in catalog {
        let at = [tile.id.x, tile.id.y];
        let block = blocks.entry(at.map(|i| i >> SHIFT)).or_insert(Gathered {
            low: at,
            high: at,
            cells: 0,
            version: 0,
            day: 0,
        });
        block.low = [block.low[0].min(at[0]), block.low[1].min(at[1])];
        block.high = [block.high[0].max(at[0]), block.high[1].max(at[1])];
        block.cells = block.cells.saturating_add(tile.cells);
        block.version = block.version.max(tile.version);
        block.day = block.day.max(tile.newest_day);
    }
    blocks
}

impl Gathered {
    /// The block on the globe; nothing where it lies in another zone altogether, which shows it too.
    fn placed(&self, grid: &Grid) -> Result<Option<OverviewBlock>, Error> {
        let corners = corners(grid, self.low, self.high)?;
        if !corners.iter().any(|at| Zone::of(*at) == Ok(grid.zone())) {
            return Ok(None);
        }
        let pick = |value: fn(&LatLon) -> f64, start: f64, better: fn(f64, f64) -> f64| {
            corners.iter().map(value).fold(start, better)
        };
        let bounds = [
            pick(|c| c.lon_deg, f64::INFINITY, f64::min),
            pick(|c| c.lat_deg, f64::INFINITY, f64::min),
            pick(|c| c.lon_deg, f64::NEG_INFINITY, f64::max),
            pick(|c| c.lat_deg, f64::NEG_INFINITY, f64::max),
        ];
        let [w, s, e, n] = bounds;
        let corners = [[w, n], [e, s]].map(|[lon_deg, lat_deg]| mercator(LatLon { lat_deg, lon_deg }));
        Ok(Some(OverviewBlock { bounds, corners, cells: self.cells, version: self.version, day: self.day }))
    }
}

/// The corners of a rectangle of tiles: south-west, south-east, north-east, north-west.
pub fn corners(grid: &Grid, low: [i32; 2], high: [i32; 2]) -> Result<[LatLon; 4], Error> {
    let zone = grid.zone();
    let MapPoint { x_m: w, y_m: s } = TileId { zone, x: low[0], y: low[1] }.origin();
    let MapPoint { x_m: e, y_m: n } = TileId { zone, x: high[0] + 1, y: high[1] + 1 }.origin();
    let at = |x, y| grid.unproject(MapPoint::new(x, y));
    Ok([at(w, s)?, at(e, s)?, at(e, n)?, at(w, n)?])
}

/// Pixels from (x0, y0) to before (x1, y1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rectangle {
    /// West.
    pub x0: usize,
    /// North.
    pub y0: usize,
    /// East.
    pub x1: usize,
    /// South.
    pub y1: usize,
}

impl Rectangle {
    /// The pixels a rectangle of the Mercator square touches, at least one; `None` outside the view.
    fn touched(view: &View, [north_west, south_east]: [[f64; 2]; 2]) -> Option<Self> {
        let side = view.side as f64;
        let (low, high) = (view.pixel_of(north_west), view.pixel_of(south_east));
        let outside = low.iter().any(|p| *p >= side) || high.iter().any(|p| *p < 0.0);
        let first = |p: f64| p.clamp(0.0, side - 1.0).floor() as usize;
        let end = |p: f64| p.clamp(0.0, side).ceil() as usize;
        let [x0, y0] = low.map(first);
        let [x1, y1] = high.map(end);
        (!outside).then_some(Self { x0, y0, x1: x1.max(x0 + 1), y1: y1.max(y0 + 1) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::{FakeStore, austin};

    #[test]
    fn bounds_hug_the_tiles_and_every_zoom_shows_them() {
        let store = FakeStore::with_tiles(&[(austin(), &[(0, 5)])]);
        let overview = Overview::of(&store).unwrap();
        let [w, s, e, n] = overview.bounds().unwrap();
        // One tile: 51.2 m.
        assert!(((n - s) * 110_900.0 - 51.2).abs() < 1.5, "{s} {n}");
        assert!(((e - w) * 96_300.0 - 51.2).abs() < 1.5, "{w} {e}");
        let [lon, lat] = overview.center().unwrap();
        for z in 0..10 {
            let [mx, my] = mercator(LatLon { lat_deg: lat, lon_deg: lon }).map(|m| m * f64::from(1_u32 << z));
            let view = View { z, x: mx as u32, y: my as u32, side: 256 };
            let (rectangle, _, spot) = overview.seen_in(&view).next().unwrap();
            assert!(spot.level > 0);
            assert!(rectangle.x1 - rectangle.x0 <= 2 && rectangle.y1 - rectangle.y0 <= 2);
        }
        assert!(overview.seen_in(&View { z: 1, x: 1, y: 1, side: 256 }).next().is_none());
    }

    #[test]
    fn an_empty_map_has_no_bounds() {
        let overview = Overview::of(&FakeStore::default()).unwrap();
        assert_eq!((overview.bounds(), overview.center()), (None, None));
    }
}
