//! The whole map from far away: blocks of 16 x 16 tiles.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use echofix_core::geo::{Grid, LatLon, TILE_M, TileId, Zone};
use echofix_core::point::MapPoint;

use super::view::mercator;
use super::{Spot, View};
use crate::http::error::Error;
use crate::http::meridians::Meridians;
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
    meridians: Meridians,
    /// South and north.
    latitudes: [f64; 2],
    /// The north-west and the south-east corner on the Mercator square; east of it when the date line lies between.
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

    /// West, south, east, north of all that is mapped; west is the larger one when the date line lies between.
    pub fn bounds(&self) -> Option<[f64; 4]> {
        let meridians = Meridians::around(self.blocks.iter().map(|block| block.meridians))?;
        let south = self.blocks.iter().map(|block| block.latitudes[0]).fold(f64::INFINITY, f64::min);
        let north = self.blocks.iter().map(|block| block.latitudes[1]).fold(f64::NEG_INFINITY, f64::max);
        Some([meridians.west_deg, south, meridians.east_deg(), north])
    }

    /// Longitude and latitude of the block with most evidence: where there is something to see.
    pub fn center(&self) -> Option<[f64; 2]> {
        let OverviewBlock { meridians, latitudes: [s, n], .. } =
            self.blocks.iter().max_by_key(|b| b.cells)?;
        Some([meridians.middle_deg(), f64::midpoint(*s, *n)])
    }

    /// What a view shows, as (rectangle of pixels it touches, version, spot).
    pub fn seen_in(&self, view: &View) -> impl Iterator<Item = (Rectangle, u64, Spot)> {
        self.blocks.iter().flat_map(move |block| {
            // What lies across the date line is at either end of the square.
            let rectangles = [0.0, 1.0]
                .into_iter()
                .filter_map(move |turn| Rectangle::touched(view, block.corners.map(|[x, y]| [x - turn, y])));
            let spot = move || Spot::of_count(block.cells, FULL, block.day);
            rectangles.map(move |rectangle| (rectangle, block.version, spot()))
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
        let around = Meridians::around(corners.map(|at| Meridians::between(at.lon_deg, at.lon_deg)));
        let Some(meridians) = around else { return Ok(None) };
        let s = pick(|c| c.lat_deg, f64::INFINITY, f64::min);
        let n = pick(|c| c.lat_deg, f64::NEG_INFINITY, f64::max);
        let (w, e) = (meridians.west_deg, meridians.west_deg + meridians.width_deg);
        let corners = [[w, n], [e, s]].map(|[lon_deg, lat_deg]| mercator(LatLon { lat_deg, lon_deg }));
        let Self { cells, version, day, .. } = *self;
        Ok(Some(OverviewBlock { meridians, latitudes: [s, n], corners, cells, version, day }))
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

    /// Catches: bounds, a middle or a far picture that leave a place out, or show the whole world for it, because the date
    /// line is near or a map lies on both of its sides.
    #[test]
    fn every_place_on_earth_is_framed_and_drawn() {
        for (lat_deg, lon_deg) in [
            (-21.14, -175.2),
            (51.88, -176.66),
            (-13.83, -171.76),
            (-16.8, 179.99),
            (-16.8, -179.99),
            (-16.8, 180.0),
            (66.0, -170.0),
            (65.0, 179.9),
            (-18.14, 178.44),
            (48.14, 11.58),
            (0.0, 0.0),
            (78.2, 15.6),
            (-54.8, -68.3),
        ] {
            let at = LatLon { lat_deg, lon_deg };
            let zones = echofix_core::geo::zones_near(at, 512.0).unwrap();
            let tile = |zone| TileId::of(zone, Grid::new(zone).unwrap().project(at).unwrap());
            let cells: &[(u32, u32)] = &[(0, 5)];
            // With others on either side, as a map of a town has them.
            let beside = |id: TileId| [-1, 0, 1].map(|x| (TileId { x: id.x + x, ..id }, cells));
            let tiles: Vec<_> = zones.into_iter().flat_map(|zone| beside(tile(zone))).collect();
            let overview = Overview::of(&FakeStore::with_tiles(&tiles)).unwrap();
            let [w, s, e, n] = overview.bounds().unwrap();
            let bounds = Meridians::between(w, e);
            assert!(bounds.width_deg < 0.1 && n - s < 0.1, "{at:?}: {w} {e}");
            assert!(bounds.meets(Meridians::between(lon_deg, lon_deg)), "{at:?}: {w} {e}");
            let [lon, lat] = overview.center().unwrap();
            assert!(
                Meridians::around([bounds, Meridians::between(lon, lon)]).unwrap().width_deg < 0.1,
                "{at:?}"
            );
            for z in 0..10 {
                let [mx, my] =
                    mercator(LatLon { lat_deg: lat, lon_deg: lon }).map(|m| m * f64::from(1_u32 << z));
                let view = View { z, x: mx as u32, y: my as u32, side: 256 };
                assert!(overview.seen_in(&view).next().is_some(), "{at:?} at zoom {z}");
            }
        }
    }

    #[test]
    fn an_empty_map_has_no_bounds() {
        let overview = Overview::of(&FakeStore::default()).unwrap();
        assert_eq!((overview.bounds(), overview.center()), (None, None));
    }
}
