//! A batch, thinned: one point for each block that holds any. Ten returns from one lamp post in one
//! batch are not independent.

use crate::point::{BodyPoint, WeightedPoint};

/// Side of the blocks that the service thins to, metres.
pub const BLOCK_M: f32 = 0.4;

/// Thins points to one, their mean, for each block of a square grid.
#[derive(Default)]
pub struct Thinner {
    /// For each block a number above `before`; what an earlier pass wrote is not above it, so that
    /// nothing has to be wiped.
    blocks: Vec<u32>,
    /// The highest number that earlier passes wrote.
    before: u32,
    /// For each block that holds any point their sum, and their number.
    sums: Vec<[f32; 3]>,
}

impl Thinner {
    /// Writes the means of the points in blocks of `block_m` into `out`, each with a vote of 1. Points
    /// farther than `reach_m` are left out.
    pub fn thin(&mut self, points: &[BodyPoint], reach_m: f32, block_m: f32, out: &mut Vec<WeightedPoint>) {
        let (grid, before) = self.begin(reach_m, block_m, points.len());
        self.sums.clear();
        self.sums.resize(points.len(), [0.0; 3]);
        let mut len = 0;
        for &BodyPoint { x_m: x, y_m: y } in
            points.iter().filter(|point| point.squared_range() <= reach_m * reach_m)
        {
            let block = &mut self.blocks[grid.block(x, y)];
            // Whether a block has points already cannot be predicted: no branch depends on it.
            let first = *block <= before;
            len += u32::from(first);
            *block = if first { before + len } else { *block };
            let sum = &mut self.sums[(*block - before - 1) as usize];
            *sum = [sum[0] + x, sum[1] + y, sum[2] + 1.0];
        }
        self.before += len;
        out.clear();
        self.sums.truncate(len as usize);
        out.extend(self.sums.iter().map(|[x, y, n]| WeightedPoint::new(x / n, y / n, 1.0)));
    }

    /// The number of points that each mean of the last thinning was made of.
    pub fn counts(&self) -> impl ExactSizeIterator<Item = f32> {
        self.sums.iter().map(|[_, _, n]| *n)
    }

    /// Divides the vote of each block among the points in it. All must lie within `reach_m`.
    pub fn share_votes(&mut self, points: &mut [WeightedPoint], reach_m: f32, block_m: f32) {
        let (grid, before) = self.begin(reach_m, block_m, points.len());
        for point in points.iter() {
            let block = &mut self.blocks[grid.block(point.x_m, point.y_m)];
            *block = before.max(*block) + 1;
        }
        for point in points.iter_mut() {
            point.vote = 1.0 / (self.blocks[grid.block(point.x_m, point.y_m)] - before) as f32;
        }
        self.before += points.len() as u32;
    }

    /// The grid, and the highest number of earlier passes: so many more can be written above it.
    fn begin(&mut self, reach_m: f32, block_m: f32, numbers: usize) -> (ThinningGrid, u32) {
        let grid = ThinningGrid::new(reach_m, block_m);
        let full = (u32::MAX - self.before) as usize <= numbers;
        if full || self.blocks.len() != grid.blocks() {
            self.blocks.clear();
            self.blocks.resize(grid.blocks(), 0);
            self.before = 0;
        }
        (grid, self.before)
    }
}

/// Blocks around the body.
struct ThinningGrid {
    half: f32,
    per_metre: f32,
    side: usize,
}

impl ThinningGrid {
    fn new(reach_m: f32, block_m: f32) -> Self {
        // One more on either side: a mean may be rounded out of its block.
        let half = (reach_m / block_m).ceil() + 1.0;
        Self { half, per_metre: 1.0 / block_m, side: 2 * half as usize + 1 }
    }

    fn blocks(&self) -> usize {
        self.side * self.side
    }

    fn block(&self, x: f32, y: f32) -> usize {
        let index = |v: f32| (v * self.per_metre + self.half) as usize;
        index(y) * self.side + index(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_point_in_reach_has_a_mean_nearby(points in prop::collection::vec((-60.0..60.0_f32, -60.0..60.0_f32), 0..200)) {
            let points: Vec<_> = points.into_iter().map(|(x, y)| BodyPoint::new(x, y)).collect();
            let mut out = Vec::new();
            Thinner::default().thin(&points, 50.0, 0.4, &mut out);
            let inside = points.iter().filter(|p| p.x_m.hypot(p.y_m) <= 50.0);
            for p in inside.clone() {
                prop_assert!(out.iter().any(|q| (p.x_m - q.x_m).abs() <= 0.401 && (p.y_m - q.y_m).abs() <= 0.401));
            }
            prop_assert!(out.len() <= inside.count());
        }
    }

    /// Catches numbers of an earlier pass that are taken for this one's.
    #[test]
    fn passes_do_not_disturb_each_other() {
        let points: Vec<_> =
            (0..500).map(|i| BodyPoint::new((i * 7 % 90) as f32 * 0.1, (i % 60) as f32 * 0.1)).collect();
        let thinned = |thinner: &mut Thinner, reach_m, block_m| {
            let mut out = Vec::new();
            thinner.thin(&points, reach_m, block_m, &mut out);
            let mut shared: Vec<_> = points.iter().map(|p| WeightedPoint::new(p.x_m, p.y_m, 1.0)).collect();
            thinner.share_votes(&mut shared, 50.0, block_m);
            let votes: f32 = shared.iter().map(|point| point.vote).sum();
            (out, votes.round() as usize)
        };
        let mut used = Thinner { before: u32::MAX - 1700, ..Thinner::default() };
        used.blocks.resize(ThinningGrid::new(50.0, 0.4).blocks(), u32::MAX - 1700);
        for (reach_m, block_m) in
            [(50.0, 0.4), (50.0, 0.4), (50.0, 0.4), (5.0, 0.4), (50.0, 1.0), (50.0, 0.4)]
        {
            let fresh = thinned(&mut Thinner::default(), reach_m, block_m);
            assert_eq!(thinned(&mut used, reach_m, block_m), fresh);
            assert!(reach_m < 50.0 || fresh.0.len() == fresh.1, "a vote for each block");
        }
    }
}
