//! Which points may lie in a sector?

use super::{BUCKET_M, Buckets, IndexRaster};
use crate::plane::{Point, add};

/// Points by bucket.
#[derive(Debug, Clone)]
pub struct PointRaster {
    raster: IndexRaster,
    buckets: Buckets,
}

impl PointRaster {
    /// Indexes points, which are known by their index in the list from then on.
    #[must_use]
    pub fn new(points: &[Point]) -> Self {
        let raster = IndexRaster::around(points.iter().copied());
        let pairs: Vec<_> = points
            .iter()
            .enumerate()
            .map(|(item, p)| {
                let [x, y] = raster.cell(*p);
                (raster.bucket((x as usize, y as usize)), item as u32)
            })
            .collect();
        let buckets = Buckets::new(raster.columns * raster.rows, &pairs);
        Self { raster, buckets }
    }

    /// Calls `visit` for a superset of the points within `radius_m` of `centre` whose bucket
    /// `may_hold` accepts, always in the same order. `may_hold` gets a circle around the bucket:
    /// its centre relative to `centre`, and its radius in metres.
    pub fn visit(
        &self,
        centre: Point,
        radius_m: f64,
        may_hold: impl Fn(Point, f64) -> bool,
        mut visit: impl FnMut(usize),
    ) {
        let circle_m = BUCKET_M * std::f64::consts::FRAC_1_SQRT_2;
        let corner = |sign: f64| add(centre, sign * radius_m, [1.0, 1.0]);
        for cell in self.raster.touched(corner(-1.0), corner(1.0)) {
            let items = self.buckets.of(self.raster.bucket(cell));
            if !items.is_empty() && may_hold(add(self.raster.centre(cell), -1.0, centre), circle_m) {
                for item in items {
                    visit(*item as usize);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::distance;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn nothing_within_the_radius_is_missed(
            points in prop::collection::vec([-90.0..90.0_f64, -90.0..90.0_f64], 0..60),
            centre in [-120.0..120.0_f64, -120.0..120.0_f64],
            radius_m in 0.1..80.0_f64,
        ) {
            let mut seen = vec![0; points.len()];
            PointRaster::new(&points).visit(centre, radius_m, |_, _| true, |item| seen[item] += 1);
            for (p, count) in points.iter().zip(seen) {
                prop_assert!(count <= 1);
                prop_assert!(count == 1 || distance(*p, centre) > radius_m);
            }
        }
    }
}
