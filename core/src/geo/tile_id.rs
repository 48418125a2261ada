//! Cells and tiles of the plane.

use std::fmt;
use std::str::FromStr;

use super::{Error, Grid, LatLon, Zone};
use crate::point::MapPoint;

/// Side of a cell, metres (paper, Sec. "Test procedure").
pub const CELL_M: f64 = 0.1;
/// Cells along a tile's side.
pub const CELLS_PER_TILE: usize = 512;
/// Side of a tile, metres.
pub const TILE_M: f64 = CELL_M * CELLS_PER_TILE as f64;

/// A cell of a zone's plane, counted from the zone's false origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CellIndex {
    /// Cells east.
    pub x: i64,
    /// Cells north.
    pub y: i64,
}

impl CellIndex {
    /// The cell that holds a point on the map.
    #[must_use]
    pub fn of(point: MapPoint) -> Self {
        Self { x: (point.x_m / CELL_M).floor() as i64, y: (point.y_m / CELL_M).floor() as i64 }
    }

    /// The cell's centre.
    #[must_use]
    pub fn centre(self) -> MapPoint {
        MapPoint::new((self.x as f64 + 0.5) * CELL_M, (self.y as f64 + 0.5) * CELL_M)
    }
}

/// A tile: its zone and its position in the zone's plane, in tiles from the false origin.
///
/// Ordered by zone, then row by row, so that neighbours are near each other in a sorted store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TileId {
    /// The zone.
    pub zone: Zone,
    /// Tiles north.
    pub y: i32,
    /// Tiles east.
    pub x: i32,
}

impl TileId {
    /// The tile that holds a position, in the zone of its longitude.
    ///
    /// # Errors
    /// When the position lies outside of UTM's latitudes.
    pub fn at(position: LatLon) -> Result<Self, Error> {
        let grid = Grid::of(position)?;
        Ok(Self::of(grid.zone(), grid.project(position)?))
    }

    /// The tile that holds a point on the map of a zone.
    #[must_use]
    pub fn of(zone: Zone, point: MapPoint) -> Self {
        Self::of_cell(zone, CellIndex::of(point))
    }

    /// The tile that holds a cell, and the cell's row-major index in it.
    #[must_use]
    pub fn locate(zone: Zone, cell: CellIndex) -> (Self, u32) {
        let tile = Self::of_cell(zone, cell);
        let first = tile.first_cell();
        (tile, ((cell.y - first.y) * CELLS_PER_TILE as i64 + cell.x - first.x) as u32)
    }

    /// The cell of a row-major index.
    #[must_use]
    pub fn cell(self, index: u32) -> CellIndex {
        let (first, side) = (self.first_cell(), CELLS_PER_TILE as u32);
        CellIndex { x: first.x + i64::from(index % side), y: first.y + i64::from(index / side) }
    }

    /// The tile that holds a cell.
    #[must_use]
    pub fn of_cell(zone: Zone, cell: CellIndex) -> Self {
        let side = CELLS_PER_TILE as i64;
        Self { zone, x: cell.x.div_euclid(side) as i32, y: cell.y.div_euclid(side) as i32 }
    }

    /// The tile and its eight neighbours, row by row.
    #[must_use]
    pub fn with_neighbours(self) -> [Self; 9] {
        std::array::from_fn(|i| Self { x: self.x + i as i32 % 3 - 1, y: self.y + i as i32 / 3 - 1, ..self })
    }

    /// The south-west corner.
    #[must_use]
    pub fn origin(self) -> MapPoint {
        MapPoint::new(f64::from(self.x) * TILE_M, f64::from(self.y) * TILE_M)
    }

    /// The centre.
    #[must_use]
    pub fn centre(self) -> MapPoint {
        self.origin().moved(0.5 * TILE_M, 0.5 * TILE_M)
    }

    /// The south-west cell.
    #[must_use]
    pub fn first_cell(self) -> CellIndex {
        let side = CELLS_PER_TILE as i64;
        CellIndex { x: i64::from(self.x) * side, y: i64::from(self.y) * side }
    }

    /// True when positions of the tile can lie in its zone or near its border: UTM's eastings stay within 400 km of
    /// the central meridian's 500 km, its northings between 0 and 10 000 km, and two kilometres beyond, for a drive along
    /// the equator is mapped in both hemispheres' zones.
    #[must_use]
    pub fn lies_on_grid(self) -> bool {
        let MapPoint { x_m, y_m } = self.origin();
        (100_000.0..900_000.0).contains(&x_m) && (-2_000.0..10_002_000.0).contains(&y_m)
    }

    /// Tiles of a zone that touch the square of half width `half_m` around a point.
    pub fn covering(zone: Zone, point: MapPoint, half_m: f64) -> impl Iterator<Item = Self> {
        let low = Self::of(zone, point.moved(-half_m, -half_m));
        let high = Self::of(zone, point.moved(half_m, half_m));
        (low.y..=high.y).flat_map(move |y| (low.x..=high.x).map(move |x| Self { zone, y, x }))
    }
}

/// `EPSG/X/Y`, decimal: a tile's identity in URLs, JSON and file names, read back by [`TileId::from_str`]. It stays as
/// it is.
impl fmt::Display for TileId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.zone.epsg(), self.x, self.y)
    }
}

impl FromStr for TileId {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let unreadable = || Error::NotATileId { text: text.to_owned() };
        let mut parts = text.split('/');
        let (Some(epsg), Some(x), Some(y), None) = (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(unreadable());
        };
        Ok(Self {
            zone: Zone::from_epsg(epsg.parse().map_err(|_| unreadable())?)?,
            x: x.parse().map_err(|_| unreadable())?,
            y: y.parse().map_err(|_| unreadable())?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Catches: another form of the identity that URLs, JSON and exported files hold.
    #[test]
    fn the_text_of_an_id_stays_as_it_is() {
        let id = TileId { zone: Zone::from_epsg(32714).unwrap(), y: 65_410, x: -3 };
        assert_eq!((id.to_string(), "32714/-3/65410".parse().unwrap()), ("32714/-3/65410".to_owned(), id));
    }

    proptest! {
        #[test]
        fn a_cell_lies_in_its_tile(x in -1e6..1e6_f64, y in 0.0..1e7_f64) {
            let zone = Zone::from_epsg(32614).unwrap();
            let cell = CellIndex::of(MapPoint::new(x, y));
            let tile = TileId::of_cell(zone, cell);
            let first = tile.first_cell();
            prop_assert!((0..512).contains(&(cell.x - first.x)) && (0..512).contains(&(cell.y - first.y)));
            let (same, index) = TileId::locate(zone, cell);
            prop_assert_eq!((same, same.cell(index)), (tile, cell));
            prop_assert_eq!(tile.to_string().parse::<TileId>().unwrap(), tile);
            let centre = cell.centre();
            prop_assert!((centre.x_m - x).abs() <= 0.051 && (centre.y_m - y).abs() <= 0.051);
        }
    }

    #[test]
    fn covering_is_the_block_of_tiles_touched() {
        let zone = Zone::from_epsg(32614).unwrap();
        let tiles: Vec<_> = TileId::covering(zone, MapPoint::new(51.2 * 10.5, 51.2 * 20.5), 50.0).collect();
        assert_eq!(tiles.len(), 9);
        assert!(tiles.is_sorted());
    }

    /// Catches: whole uploads refused near the equator.
    #[test]
    fn what_is_seen_from_the_equator_lies_on_the_grids_of_both_hemispheres() {
        use crate::geo::{Grid, LatLon, zones_near};
        for lat_deg in [-0.001, 0.0, 0.001] {
            let at = LatLon { lat_deg, lon_deg: 109.3 };
            let zones = zones_near(at, 512.0).unwrap();
            assert_eq!(zones.len(), 2, "both hemispheres'");
            for zone in zones {
                let centre = Grid::new(zone).unwrap().project(at).unwrap();
                let seen = TileId::covering(zone, centre, 512.0 + 500.0);
                assert!(seen.into_iter().all(TileId::lies_on_grid), "{lat_deg} {zone:?}");
            }
        }
    }

    #[test]
    fn unreadable_ids_say_what_was_expected() {
        for text in ["", "32614/1", "32614/1/2/3", "4326/1/2", "32614/a/2"] {
            assert!(text.parse::<TileId>().is_err(), "{text}");
        }
    }
}
