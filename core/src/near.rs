//! Is a point near the map? For that alone the map's points need no tree: a bit a cell says where there is any.

use crate::geo::{CELL_M, CELLS_PER_TILE, TileId};
use crate::point::MapPoint;

/// Cells along the side of a square, which has a bit for each of its cells in one word.
const SQUARE: i64 = 8;

/// The cells of a tile, and those just beyond its borders, that hold a point.
pub struct NearPoints {
    corner: MapPoint,
    /// Row of squares of the first of `starts`.
    first_row: i64,
    /// For each row of squares the first of its squares; one more at the end.
    starts: Box<[u16]>,
    /// Squares with any point, row by row: the column of each.
    columns: Box<[i16]>,
    /// The cells of each with a point, row by row, the westernmost in the lowest bit.
    cells: Box<[u64]>,
}

impl NearPoints {
    /// Packs points given in cells from a tile's south-west corner, at most one square from the tile.
    #[must_use]
    pub fn new(tile: TileId, points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let mut places: Vec<_> = points.into_iter().map(place).collect();
        places.sort_unstable();
        let first_row = places.first().map_or(0, |(row, _, _)| *row);
        let (mut starts, mut columns, mut cells) = (vec![0_u16], Vec::new(), Vec::new());
        let mut last = None;
        for (row, column, bit) in places {
            if last != Some((row, column)) {
                while first_row + starts.len() as i64 <= row {
                    starts.push(columns.len() as u16);
                }
                columns.push(column as i16);
                cells.push(0);
                last = Some((row, column));
            }
            if let Some(cells) = cells.last_mut() {
                *cells |= 1_u64 << bit;
            }
        }
        starts.push(columns.len() as u16);
        Self {
            corner: tile.origin(),
            first_row,
            starts: starts.into_boxed_slice(),
            columns: columns.into_boxed_slice(),
            cells: cells.into_boxed_slice(),
        }
    }

    /// Is the middle of a cell with a point within so many metres?
    #[must_use]
    pub fn is_near(&self, position: MapPoint, radius_m: f64) -> bool {
        let at = [position.x_m - self.corner.x_m, position.y_m - self.corner.y_m].map(|along| along / CELL_M);
        let radius = radius_m / CELL_M;
        let square = |along: f64| (along.floor() as i64).div_euclid(SQUARE);
        let [columns, mut rows] = at.map(|along| square(along - radius)..=square(along + radius));
        rows.any(|row| {
            self.row(row).any(|square| {
                let column = i64::from(self.columns[square]);
                columns.contains(&column) && square_has(self.cells[square], [column, row], at, radius)
            })
        })
    }

    /// The squares of a row.
    fn row(&self, row: i64) -> std::ops::Range<usize> {
        let at = usize::try_from(row - self.first_row).ok();
        let ends = at.and_then(|at| Some((*self.starts.get(at)?, *self.starts.get(at + 1)?)));
        ends.map_or(0..0, |(from, to)| usize::from(from)..usize::from(to))
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.starts) + size_of_val(&*self.columns) + size_of_val(&*self.cells)
    }
}

/// Row and column of the square that a point lies in, and the bit of its cell.
fn place([x, y]: [f64; 2]) -> (i64, i64, u32) {
    let cell = |along: f64| (along.floor() as i64).clamp(-SQUARE, CELLS_PER_TILE as i64 + SQUARE - 1);
    let (column, row) = (cell(x), cell(y));
    let bit = row.rem_euclid(SQUARE) * SQUARE + column.rem_euclid(SQUARE);
    (row.div_euclid(SQUARE), column.div_euclid(SQUARE), bit as u32)
}

fn square_has(mut cells: u64, [column, row]: [i64; 2], at: [f64; 2], radius: f64) -> bool {
    while cells != 0 {
        let bit = i64::from(cells.trailing_zeros());
        let x = (column * SQUARE + bit % SQUARE) as f64 + 0.5;
        let y = (row * SQUARE + bit / SQUARE) as f64 + 0.5;
        if (x - at[0]).powi(2) + (y - at[1]).powi(2) <= radius * radius {
            return true;
        }
        cells &= cells - 1;
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::Zone;
    use proptest::prelude::*;

    fn tile() -> TileId {
        TileId { zone: Zone::from_epsg(32614).unwrap(), y: 100, x: 200 }
    }

    proptest! {
        // Breaks it: a square that is not looked at, or one taken for its neighbour.
        #[test]
        fn it_says_what_a_full_search_says(
            points in prop::collection::vec((-8.0..519.9_f64, -8.0..519.9_f64), 0..300),
            asked in prop::collection::vec((0.0..512.0_f64, 0.0..512.0_f64), 1..40),
            radius_m in 0.15..3.0_f64,
        ) {
            let points: Vec<[f64; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
            let near = NearPoints::new(tile(), points.iter().copied());
            for (x, y) in asked.into_iter().chain(points.iter().map(|at| (at[0] + 0.3 / CELL_M, at[1]))) {
                let distance = |at: &[f64; 2]| (at[0] - x).hypot(at[1] - y) * CELL_M;
                let nearest = points.iter().map(distance).fold(f64::INFINITY, f64::min);
                let said = near.is_near(tile().origin().moved(x * CELL_M, y * CELL_M), radius_m);
                // Half a cell's diagonal.
                if (nearest - radius_m).abs() > 0.071 {
                    prop_assert_eq!(said, nearest < radius_m, "{} {}", nearest, radius_m);
                }
            }
        }
    }
}
