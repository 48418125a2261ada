//! Is a point near the map, exactly? The points lie in buckets of a metre or two, so that few are looked at.

use crate::agreement::relative;
use crate::geo::{CELL_M, TILE_M, TileId};
use crate::point::MapPoint;

/// Side of a bucket, metres.
const BUCKET_M: f64 = 1.6;
/// Buckets around the tile: what is weighed lies beyond its border by less.
const AROUND: usize = 1;
/// Buckets along a side.
const SIDE: usize = (TILE_M / BUCKET_M) as usize + 2 * AROUND;
/// What a position is off by at most in single precision, metres, within a tile of the first point.
const ROUNDING_M: f64 = 1e-3;

/// The points of a tile, and those just beyond its borders.
pub struct PointBuckets {
    /// South-west corner of the first bucket.
    corner: MapPoint,
    /// Positions are relative to it: f32 is exact to a hundredth of a millimetre within a tile.
    origin: MapPoint,
    /// For each bucket, row by row, the first of its points; one more at the end.
    starts: Box<[u32]>,
    points: Box<[[f32; 2]]>,
}

impl PointBuckets {
    /// Sorts points given in cells from a tile's south-west corner, at most one bucket from the tile.
    #[must_use]
    pub fn new(tile: TileId, points: impl Iterator<Item = [f64; 2]> + Clone) -> Self {
        let position = |[x, y]: [f64; 2]| tile.origin().moved(x * CELL_M, y * CELL_M);
        let origin = points.clone().next().map(position).unwrap_or_default();
        let around = AROUND as f64 * BUCKET_M;
        let corner = tile.origin().moved(-around, -around);
        let mut starts = vec![0_u32; SIDE * SIDE + 1];
        let row = |cells: f64| row_of(cells * CELL_M + around);
        let buckets: Vec<usize> = points.clone().map(|[x, y]| row(y) * SIDE + row(x)).collect();
        for bucket in &buckets {
            starts[bucket + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut sorted = vec![[0.0; 2]; starts[SIDE * SIDE] as usize];
        for (point, bucket) in points.zip(buckets) {
            let slot = &mut next[bucket];
            sorted[*slot as usize] = relative(position(point), origin);
            *slot += 1;
        }
        Self { corner, origin, starts: starts.into_boxed_slice(), points: sorted.into_boxed_slice() }
    }

    /// Is a point within so many metres?
    #[must_use]
    pub fn is_near(&self, position: MapPoint, radius_m: f64) -> bool {
        let asked = relative(position, self.origin);
        let near = |[x, y]: &[f32; 2]| {
            let (dx, dy) = (x - asked[0], y - asked[1]);
            f64::from(dx * dx + dy * dy).sqrt() <= radius_m
        };
        let reach = radius_m + ROUNDING_M;
        let buckets = |along: f64| row_of(along - reach)..row_of(along + reach) + 1;
        let columns = buckets(position.x_m - self.corner.x_m);
        buckets(position.y_m - self.corner.y_m).any(|row| {
            let at = |column: usize| self.starts[row * SIDE + column] as usize;
            self.points[at(columns.start)..at(columns.end)].iter().any(near)
        })
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.starts) + size_of_val(&*self.points)
    }
}

/// The row, or column, of buckets at a distance from the corner, metres; what lies outside counts to the outermost.
fn row_of(along_m: f64) -> usize {
    ((along_m / BUCKET_M).max(0.0) as usize).min(SIDE - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agreement::MapPointIndex;
    use crate::geo::Zone;
    use proptest::prelude::*;

    fn tile() -> TileId {
        TileId { zone: Zone::from_epsg(32614).unwrap(), y: 64_500, x: 11_700 }
    }

    proptest! {
        // Breaks it: a bucket that is not looked at, or a distance rounded in another way than the tree's: the map would no
        // longer be the one that was folded before.
        #[test]
        fn it_says_what_a_tree_of_the_points_says(
            points in prop::collection::vec((-8.0..519.9_f64, -8.0..519.9_f64), 0..300),
            asked in prop::collection::vec((-3.0..514.0_f64, -3.0..514.0_f64), 1..60),
            radius_m in 0.15..3.0_f64,
        ) {
            let cells = points.iter().map(|(x, y)| [*x, *y]);
            let at = |x: f64, y: f64| tile().origin().moved(x * CELL_M, y * CELL_M);
            let (buckets, tree) = (PointBuckets::new(tile(), cells), MapPointIndex::new(points.iter().map(|(x, y)| at(*x, *y))));
            let on_the_rim = points.iter().map(|(x, y)| (x + radius_m / CELL_M, *y));
            for (x, y) in asked.into_iter().chain(on_the_rim) {
                let near = tree.distance_m(at(x, y)).is_some_and(|distance| distance <= radius_m);
                prop_assert_eq!(buckets.is_near(at(x, y), radius_m), near, "{} {}", x, y);
            }
        }
    }
}
