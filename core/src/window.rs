//! Which square of the map an alignment needs, and the paper's window of evidence in it.
//!
//! Squares lie on a coarse lattice, so that requests one after the other often have the same: then its images
//! need not be assembled anew, nor its spectrum be computed.

use crate::evidence::Cell;
use crate::geo::{CELL_M, CELLS_PER_TILE, CellIndex, TileId, Zone};
use crate::point::MapPoint;
use crate::tile::Tile;

/// Step of the lattice of square centres, cells.
const LATTICE_CELLS: i64 = 64;

/// A square of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MapSquare {
    /// The zone.
    pub zone: Zone,
    /// The south-west cell.
    pub origin: CellIndex,
    /// Cells along a side.
    pub side: usize,
}

impl MapSquare {
    /// The square to align against around a position: it holds `extent_m` in every direction of
    /// every pose within `search_m` of the position, plus the lattice's slack. Its side is a length
    /// the FFT likes.
    #[must_use]
    pub fn around(zone: Zone, position: MapPoint, extent_m: f64, search_m: f64) -> Self {
        let reach = ((extent_m + search_m) / CELL_M).ceil() as usize + 1;
        let side = fft_length(2 * reach + LATTICE_CELLS as usize);
        let at = CellIndex::of(position);
        let snap = |c: i64| (c + LATTICE_CELLS / 2).div_euclid(LATTICE_CELLS) * LATTICE_CELLS;
        let half = side as i64 / 2;
        Self { zone, origin: CellIndex { x: snap(at.x) - half, y: snap(at.y) - half }, side }
    }

    /// Tiles that touch the square.
    pub fn tiles(&self) -> impl Iterator<Item = TileId> + use<> {
        let reach = self.side as i64 - 1;
        let last = CellIndex { x: self.origin.x + reach, y: self.origin.y + reach };
        let (low, high) = (TileId::of_cell(self.zone, self.origin), TileId::of_cell(self.zone, last));
        let zone = self.zone;
        (low.y..=high.y).flat_map(move |y| (low.x..=high.x).map(move |x| TileId { zone, y, x }))
    }

    /// A point in cells from the south-west corner (with the fraction within a cell), column and row.
    #[must_use]
    pub fn to_cells(&self, point: MapPoint) -> [f64; 2] {
        [point.x_m / CELL_M - self.origin.x as f64, point.y_m / CELL_M - self.origin.y as f64]
    }

    /// The south-west corner.
    #[must_use]
    pub fn corner(&self) -> MapPoint {
        self.to_map([0.0, 0.0])
    }

    /// The point so many cells from the south-west corner, by column and row.
    #[must_use]
    pub fn to_map(&self, [x, y]: [f64; 2]) -> MapPoint {
        MapPoint::new((x + self.origin.x as f64) * CELL_M, (y + self.origin.y as f64) * CELL_M)
    }
}

/// The shortest length of at least `least` that transforms fast: a multiple of 48 with no prime
/// factor above 5.
///
/// The vectorised butterflies are for powers of two and three; 1200 takes little more than half the
/// time of 1250.
fn fft_length(least: usize) -> usize {
    const STEP: usize = 48;
    let smooth = |mut n: usize| {
        for p in [2, 3, 5] {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1
    };
    let mut n = least.next_multiple_of(STEP);
    while !smooth(n) {
        n += STEP;
    }
    n
}

/// An occupied cell of a [`EvidenceWindow`]. Paper only: used by the evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowCell {
    /// Column, cells from the window's west side.
    pub x: u16,
    /// Row, cells from the window's south side.
    pub y: u16,
    /// What the map knows of it.
    pub cell: Cell,
}

impl WindowCell {
    /// Mean position of its hits, cells from the window's south-west corner.
    #[must_use]
    pub fn centroid(&self) -> [f64; 2] {
        let [fx, fy] = self.cell.centroid();
        [f64::from(self.x) + fx, f64::from(self.y) + fy]
    }
}

/// The map's evidence in a square. Paper only: used by the evaluation; the service aligns on
/// [`crate::align::view::MapView`].
#[derive(Debug, Clone)]
pub struct EvidenceWindow {
    /// Which square.
    pub square: MapSquare,
    /// Occupied cells.
    pub cells: Vec<WindowCell>,
}

impl EvidenceWindow {
    /// Stitches a window from the tiles that exist in its square.
    #[must_use]
    pub fn stitch<'a>(square: MapSquare, tiles: impl IntoIterator<Item = (TileId, &'a Tile)>) -> Self {
        let mut cells = Vec::new();
        for (id, tile) in tiles {
            let first = id.first_cell();
            let (dx, dy) = (first.x - square.origin.x, first.y - square.origin.y);
            let side = 0..square.side as i64;
            cells.extend(tile.cells().iter().filter_map(|(index, cell)| {
                let x = dx + i64::from(*index) % CELLS_PER_TILE as i64;
                let y = dy + i64::from(*index) / CELLS_PER_TILE as i64;
                let inside = side.contains(&x) && side.contains(&y);
                inside.then_some(WindowCell { x: x as u16, y: y as u16, cell: *cell })
            }));
        }
        Self { square, cells }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn zone() -> Zone {
        Zone::from_epsg(32614).unwrap()
    }

    proptest! {
        #[test]
        fn a_square_holds_every_pose_searched_with_its_batch(x in -1e5..1e6_f64, y in 0.0..9e6_f64, search in 0.1..30.0_f64) {
            let square = MapSquare::around(zone(), MapPoint::new(x, y), 50.0, search);
            for sign in [-1.0, 1.0] {
                let [u, v] = square.to_cells(MapPoint::new(x, y).moved(sign * (50.0 + search), sign * (50.0 + search)));
                prop_assert!(u >= 0.0 && v >= 0.0 && u < square.side as f64 && v < square.side as f64);
            }
            let tiles: Vec<_> = square.tiles().collect();
            prop_assert!(tiles.contains(&TileId::of(zone(), MapPoint::new(x, y))));
            let back = square.to_map(square.to_cells(MapPoint::new(x, y)));
            prop_assert!((back.x_m - x).abs() < 1e-6 && (back.y_m - y).abs() < 1e-6);
        }
    }

    #[test]
    fn neighbours_have_the_same_square() {
        let a = MapSquare::around(zone(), MapPoint::new(600_003.0, 3_300_003.0), 50.0, 6.0);
        let b = MapSquare::around(zone(), MapPoint::new(600_002.1, 3_300_002.9), 50.0, 6.0);
        assert_eq!(a, b);
        assert_eq!(a.side, 1200);
    }

    #[test]
    fn cells_keep_their_position_on_the_map() {
        let position = MapPoint::new(600_010.03, 3_300_020.07);
        let (id, index) = TileId::locate(zone(), CellIndex::of(position));
        let tile = Tile::from_cells(vec![(
            index,
            Cell { hits: 1, passes: 1, offset_sum: [76, 179], ..Cell::default() },
        )])
        .unwrap();
        let square = MapSquare::around(zone(), MapPoint::new(600_000.0, 3_300_000.0), 50.0, 6.0);
        let window = EvidenceWindow::stitch(square, [(id, &tile)]);
        let there = square.to_map(window.cells[0].centroid());
        assert!(there.distance_m(position) < 1e-3, "{there:?}");
    }

    #[test]
    fn lengths_transform_fast() {
        assert_eq!([1, 1186, 1200, 1201, 1666].map(fft_length), [48, 1200, 1200, 1296, 1728]);
    }
}
