//! Uniform-grid indices of points and of segments.

mod points;
mod segments;

pub use points::PointRaster;
pub use segments::SegmentIndex;

use crate::plane::Point;

/// Side of a bucket, metres.
const BUCKET_M: f64 = 8.0;

/// The raster of both indices: buckets over a bounding box, row by row.
#[derive(Debug, Clone)]
struct IndexRaster {
    low: Point,
    columns: usize,
    rows: usize,
}

impl IndexRaster {
    fn around(points: impl Iterator<Item = Point>) -> Self {
        let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
        for p in points {
            for axis in 0..2 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        if low[0] > high[0] {
            (low, high) = ([0.0; 2], [0.0; 2]);
        }
        let count = |axis: usize| ((high[axis] - low[axis]) / BUCKET_M) as usize + 1;
        Self { low, columns: count(0), rows: count(1) }
    }

    /// Column and row of a point, in buckets; outside the box when out of `0..columns`, `0..rows`.
    fn cell(&self, p: Point) -> [f64; 2] {
        [(p[0] - self.low[0]) / BUCKET_M, (p[1] - self.low[1]) / BUCKET_M]
    }

    /// Columns and rows touched by the box between two corners.
    fn touched(&self, low: Point, high: Point) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (from, to) = (self.cell(low), self.cell(high));
        let span = |axis: usize, count: usize| {
            let end = (to[axis].floor() as i64 + 1).clamp(0, count as i64);
            (from[axis].floor() as i64).clamp(0, end) as usize..end as usize
        };
        let (columns, rows) = (span(0, self.columns), span(1, self.rows));
        rows.flat_map(move |row| columns.clone().map(move |column| (column, row)))
    }

    fn bucket(&self, (column, row): (usize, usize)) -> usize {
        row * self.columns + column
    }

    fn centre(&self, (column, row): (usize, usize)) -> Point {
        [self.low[0] + (column as f64 + 0.5) * BUCKET_M, self.low[1] + (row as f64 + 0.5) * BUCKET_M]
    }
}

/// Lists per bucket in one array: `items[starts[b]..starts[b + 1]]`.
#[derive(Debug, Clone)]
struct Buckets {
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Buckets {
    /// From (bucket, item) pairs; the items of a bucket keep their order.
    fn new(count: usize, pairs: &[(usize, u32)]) -> Self {
        let mut starts = vec![0_u32; count + 1];
        for (bucket, _) in pairs {
            starts[bucket + 1] += 1;
        }
        for bucket in 0..count {
            starts[bucket + 1] += starts[bucket];
        }
        let mut next = starts.clone();
        let mut items = vec![0; pairs.len()];
        for (bucket, item) in pairs {
            items[next[*bucket] as usize] = *item;
            next[*bucket] += 1;
        }
        Self { starts, items }
    }

    fn of(&self, bucket: usize) -> &[u32] {
        &self.items[self.starts[bucket] as usize..self.starts[bucket + 1] as usize]
    }
}
