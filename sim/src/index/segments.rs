//! Which segments does a ray cross?

use std::ops::ControlFlow;

use super::{BUCKET_M, Buckets, IndexRaster};
use crate::plane::{LineSegment, Point, sub};

const SLACK_M: f64 = 1e-6;

/// Segments by bucket, for rays.
#[derive(Debug, Clone)]
pub struct SegmentIndex {
    raster: IndexRaster,
    buckets: Buckets,
    segments: Vec<LineSegment>,
}

impl SegmentIndex {
    /// Indexes segments, which are known by their index in the list from then on.
    #[must_use]
    pub fn new(segments: Vec<LineSegment>) -> Self {
        let raster = IndexRaster::around(segments.iter().flat_map(|s| [s.a, s.b]));
        let mut pairs = Vec::new();
        for (item, LineSegment { a, b }) in segments.iter().enumerate() {
            // The slack leaves a crossing on a bucket's border findable from either side.
            let low = [a[0].min(b[0]) - SLACK_M, a[1].min(b[1]) - SLACK_M];
            let high = [a[0].max(b[0]) + SLACK_M, a[1].max(b[1]) + SLACK_M];
            pairs.extend(raster.touched(low, high).map(|cell| (raster.bucket(cell), item as u32)));
        }
        let buckets = Buckets::new(raster.columns * raster.rows, &pairs);
        Self { raster, buckets, segments }
    }

    /// Calls `cross` once for each segment between `p` and `q`, roughly from `p` on, until it breaks.
    pub fn visit(&self, p: Point, q: Point, mut cross: impl FnMut(usize) -> ControlFlow<()>) {
        for (bucket, from, to) in Walk::new(&self.raster, p, q) {
            for item in self.buckets.of(bucket) {
                // A segment listed in several buckets counts in the one that holds the crossing.
                let here = self.segments[*item as usize].crossing(p, q).is_some_and(|t| t >= from && t < to);
                if here && cross(*item as usize).is_break() {
                    return;
                }
            }
        }
    }

    /// True when anything lies between `p` and `q`.
    #[must_use]
    pub fn blocks(&self, p: Point, q: Point) -> bool {
        let mut blocked = false;
        self.visit(p, q, |_| {
            blocked = true;
            ControlFlow::Break(())
        });
        blocked
    }
}

/// The buckets along a ray (Amanatides and Woo), each with the part of the ray inside it.
struct Walk<'a> {
    raster: &'a IndexRaster,
    cell: [i64; 2],
    step: [i64; 2],
    /// Fraction of the ray at which the next border of each axis is reached, and from one to the next.
    next: [f64; 2],
    stride: [f64; 2],
    from: f64,
}

impl<'a> Walk<'a> {
    fn new(raster: &'a IndexRaster, p: Point, q: Point) -> Self {
        let (start, way) = (raster.cell(p), sub(q, p));
        let cell = start.map(|v| v.floor() as i64);
        let (mut step, mut next, mut stride) = ([0; 2], [f64::INFINITY; 2], [f64::INFINITY; 2]);
        for axis in 0..2 {
            if way[axis] != 0.0 {
                let forward = way[axis] > 0.0;
                step[axis] = if forward { 1 } else { -1 };
                stride[axis] = BUCKET_M / way[axis].abs();
                let inside = start[axis] - cell[axis] as f64;
                next[axis] = stride[axis] * if forward { 1.0 - inside } else { inside };
            }
        }
        Self { raster, cell, step, next, stride, from: 0.0 }
    }
}

impl Iterator for Walk<'_> {
    type Item = (usize, f64, f64);

    fn next(&mut self) -> Option<Self::Item> {
        let size = [self.raster.columns as i64, self.raster.rows as i64];
        while self.from <= 1.0 {
            let axis = usize::from(self.next[1] < self.next[0]);
            let (cell, from, to) = (self.cell, self.from, self.next[axis]);
            self.from = to;
            self.next[axis] += self.stride[axis];
            self.cell[axis] += self.step[axis];
            if (0..2).all(|a| (0..size[a]).contains(&cell[a])) {
                return Some((self.raster.bucket((cell[0] as usize, cell[1] as usize)), from, to));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Point> {
        [-60.0..60.0_f64, -60.0..60.0_f64]
    }

    proptest! {
        #[test]
        fn every_crossing_is_met_once(
            ends in prop::collection::vec((point(), point()), 0..40),
            p in point(),
            q in point(),
        ) {
            let segments: Vec<_> = ends.into_iter().map(|(a, b)| LineSegment { a, b }).collect();
            let mut met = vec![0; segments.len()];
            SegmentIndex::new(segments.clone()).visit(p, q, |item| {
                met[item] += 1;
                ControlFlow::Continue(())
            });
            for (segment, count) in segments.iter().zip(met) {
                prop_assert_eq!(count, i32::from(segment.crossing(p, q).is_some()));
            }
        }
    }
}
