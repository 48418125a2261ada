//! One Web-Mercator tile of pixels, and its pixels on a zone's plane.

use std::f64::consts::PI;

use echofix_core::geo::{self, Grid, LatLon};
use echofix_core::point::MapPoint;

use crate::http::error::Error;

/// Deepest zoom served: a cell of 10 cm is then about three pixels wide.
pub const MAX_ZOOM: u8 = 22;
/// Length of the equator in Web Mercator, metres.
const EQUATOR_M: f64 = 2.0 * PI * 6_378_137.0;
/// Pixels between the nodes of the projection's lattice.
const STEP: usize = 8;

/// A tile of the Web-Mercator pyramid (z/x/y, y from the north) as a square of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct View {
    /// Zoom level: the world is 2^z tiles wide.
    pub z: u8,
    /// Column, counted eastward from 180 degrees west.
    pub x: u32,
    /// Row, counted southward from the north.
    pub y: u32,
    /// Pixels along a side: 256, or 512 for dense screens.
    pub side: usize,
}

impl View {
    /// The view of `{z}/{x}/{y}.png` or `{z}/{x}/{y}@2x.png`.
    ///
    /// # Errors
    /// When that is not an address of a tile.
    pub fn parse(z: &str, x: &str, file: &str) -> Result<Self, Error> {
        let expected = || {
            Error::BadRequest(format!(
                "`{z}/{x}/{file}` is not a map tile; expected z/x/y.png or z/x/y@2x.png with z from 0 to \
                 {MAX_ZOOM} and x, y from 0 to 2^z - 1"
            ))
        };
        let stem = file.strip_suffix(".png").ok_or_else(expected)?;
        let (y, side) = stem.strip_suffix("@2x").map_or((stem, 256), |y| (y, 512));
        let number =
            |text: &str| text.parse::<u32>().ok().filter(|_| text.bytes().all(|b| b.is_ascii_digit()));
        let (Some(z), Some(x), Some(y)) = (number(z), number(x), number(y)) else { return Err(expected()) };
        let exists = z <= u32::from(MAX_ZOOM) && x < 1 << z && y < 1 << z;
        exists.then_some(Self { z: z as u8, x, y, side }).ok_or_else(expected)
    }

    /// The position of a point of the image, in pixels from its north-west corner.
    pub fn at(&self, px: f64, py: f64) -> LatLon {
        let tiles = f64::from(1_u32 << self.z);
        let side = self.side as f64;
        unmercator([(f64::from(self.x) + px / side) / tiles, (f64::from(self.y) + py / side) / tiles])
    }

    /// Pixels from the north-west corner of a point of the Mercator square.
    pub fn pixel_of(&self, [mx, my]: [f64; 2]) -> [f64; 2] {
        let tiles = f64::from(1_u32 << self.z);
        let side = self.side as f64;
        [(mx * tiles - f64::from(self.x)) * side, (my * tiles - f64::from(self.y)) * side]
    }

    /// Metres on the ground that a pixel is wide, at the middle of the image.
    pub fn pixel_m(&self) -> f64 {
        let middle = self.side as f64 / 2.0;
        let shrink = self.at(middle, middle).lat_deg.to_radians().cos();
        EQUATOR_M * shrink / f64::from(1_u32 << self.z) / self.side as f64
    }
}

/// A position on the Mercator square: 0 to 1 from west to east and from north to south.
pub fn mercator(at: LatLon) -> [f64; 2] {
    let y = at.lat_deg.to_radians().tan().asinh();
    [at.lon_deg / 360.0 + 0.5, 0.5 - y / (2.0 * PI)]
}

fn unmercator([x, y]: [f64; 2]) -> LatLon {
    let lat = (PI * (1.0 - 2.0 * y)).sinh().atan();
    LatLon { lat_deg: lat.to_degrees(), lon_deg: (x * 360.0 - 180.0).clamp(-180.0, 180.0) }
}

/// A view's pixels on a zone's plane: projected at every eighth pixel, interpolated between.
pub struct PixelGrid {
    /// Easting and northing.
    nodes: Vec<[f64; 2]>,
    per_side: usize,
}

impl PixelGrid {
    /// Projects the nodes.
    ///
    /// # Errors
    /// When the projection has no answer for one of them.
    pub fn new(view: &View, grid: &Grid) -> Result<Self, geo::Error> {
        let per_side = view.side / STEP + 1;
        let node = |i: usize| {
            let (row, column) = (i / per_side, i % per_side);
            grid.project(view.at((column * STEP) as f64, (row * STEP) as f64)).map(Into::into)
        };
        let nodes = (0..per_side * per_side).map(node).collect::<Result<_, _>>()?;
        Ok(Self { nodes, per_side })
    }

    /// Where a point of the image lies on the map.
    pub fn at(&self, px: f64, py: f64) -> MapPoint {
        let (u, v) = (px / STEP as f64, py / STEP as f64);
        let last = self.per_side - 2;
        let (column, row) = ((u as usize).min(last), (v as usize).min(last));
        let (u, v) = (u - column as f64, v - row as f64);
        let node = |east: usize, south: usize| self.nodes[(row + south) * self.per_side + column + east];
        let [nw, ne, sw, se] = [node(0, 0), node(1, 0), node(0, 1), node(1, 1)];
        let between = |i: usize| {
            let north = nw[i] + u * (ne[i] - nw[i]);
            let south = sw[i] + u * (se[i] - sw[i]);
            north + v * (south - north)
        };
        MapPoint::new(between(0), between(1))
    }

    /// The smallest rectangle of the map around the image: its south-west and north-east corner.
    pub fn bounds(&self) -> [MapPoint; 2] {
        let fold = |start: f64, pick: fn(f64, f64) -> f64| {
            MapPoint::from([0, 1].map(|axis| self.nodes.iter().map(|n| n[axis]).fold(start, pick)))
        };
        [fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The view at a zoom that shows a position.
    pub fn over(at: LatLon, z: u8, side: usize) -> View {
        let [mx, my] = mercator(at).map(|m| m * f64::from(1_u32 << z));
        View { z, x: mx as u32, y: my as u32, side }
    }

    proptest! {
        #[test]
        fn the_lattice_is_within_5_cm_of_the_projection(
            lat_deg in -79.0..83.0_f64, lon_deg in -179.9..179.9_f64, z in 12..=22_u8,
            px in 0.0..256.0_f64, py in 0.0..256.0_f64,
        ) {
            let view = over(LatLon { lat_deg, lon_deg }, z, 256);
            let grid = Grid::of(view.at(128.0, 128.0)).unwrap();
            let pixel_grid = PixelGrid::new(&view, &grid).unwrap();
            let exact = grid.project(view.at(px, py)).unwrap();
            let near = pixel_grid.at(px, py);
            let error = exact.distance_m(near);
            prop_assert!(error < 0.05, "{error} m at {view:?}");
        }

        #[test]
        fn mercator_and_back_is_the_identity(lat_deg in -84.0..84.0_f64, lon_deg in -180.0..180.0_f64) {
            let view = over(LatLon { lat_deg, lon_deg }, 10, 256);
            let [px, py] = view.pixel_of(mercator(LatLon { lat_deg, lon_deg }));
            prop_assert!((-1e-6..256.001).contains(&px) && (-1e-6..256.001).contains(&py));
            let back = view.at(px, py);
            prop_assert!((back.lat_deg - lat_deg).abs() < 1e-9 && (back.lon_deg - lon_deg).abs() < 1e-9);
        }
    }

    #[test]
    fn a_known_tile_covers_a_known_position() {
        // A quarter of the square down lies gd(pi / 2) = 66.513 26 degrees north.
        let row = |lat_deg| over(LatLon { lat_deg, lon_deg: 90.1 }, 2, 256);
        assert_eq!(row(66.514), View { z: 2, x: 3, y: 0, side: 256 });
        assert_eq!(row(66.512), View { z: 2, x: 3, y: 1, side: 256 });
        // At the equator a pixel of zoom 0 is 156 543.03 m wide.
        let world = View { z: 0, x: 0, y: 0, side: 256 };
        assert!((world.pixel_m() - 156_543.03).abs() < 0.01);
    }

    #[test]
    fn addresses_are_checked() {
        assert_eq!(View::parse("3", "7", "0@2x.png").unwrap(), View { z: 3, x: 7, y: 0, side: 512 });
        let bad = [
            ("23", "0", "0.png"),
            ("1", "2", "0.png"),
            ("1", "0", "2.png"),
            ("1", "0", "0.jpg"),
            ("1", "0", "0"),
            ("a", "0", "0.png"),
            ("1", "-1", "0.png"),
            ("1", "+1", "0.png"),
            ("", "", ".png"),
            ("99999999999", "0", "0.png"),
            ("1", "0", "0@3x.png"),
        ];
        for (z, x, file) in bad {
            assert!(matches!(View::parse(z, x, file), Err(Error::BadRequest(_))), "{z}/{x}/{file}");
        }
    }
}
