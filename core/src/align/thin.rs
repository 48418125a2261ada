//! A batch, thinned: one point for each block that holds any. Ten returns from one lamp post in one
//! batch are not independent.

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
    sums: Vec<[f32; 3]>,
}

impl Thinner {
    /// Writes the means of the points in blocks of `block_m` into `out`: ground metres in the
    /// body's frame, and 1, the vote of each. Points farther than `reach_m` are left out.
    pub fn thin(&mut self, points: &[[f32; 2]], reach_m: f32, block_m: f32, out: &mut Vec<[f32; 3]>) {
        let (grid, before) = self.begin(reach_m, block_m, points.len());
        self.sums.clear();
        self.sums.resize(points.len(), [0.0; 3]);
        let mut len = 0;
        for &[x, y] in points.iter().filter(|[x, y]| x * x + y * y <= reach_m * reach_m) {
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
        out.extend(self.sums[..len as usize].iter().map(|[x, y, n]| [x / n, y / n, 1.0]));
    }

    /// Divides the vote of each block among the points in it. All must lie within `reach_m`.
    pub fn share_votes(&mut self, points: &mut [[f32; 3]], reach_m: f32, block_m: f32) {
        let (grid, before) = self.begin(reach_m, block_m, points.len());
        for [x, y, _] in points.iter() {
            let block = &mut self.blocks[grid.block(*x, *y)];
            *block = before.max(*block) + 1;
        }
        for [x, y, vote] in points.iter_mut() {
            *vote = 1.0 / (self.blocks[grid.block(*x, *y)] - before) as f32;
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
            let points: Vec<[f32; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
            let mut out = Vec::new();
            Thinner::default().thin(&points, 50.0, 0.4, &mut out);
            let inside = points.iter().filter(|[x, y]| x.hypot(*y) <= 50.0);
            for p in inside.clone() {
                prop_assert!(out.iter().any(|q| (p[0] - q[0]).abs() <= 0.401 && (p[1] - q[1]).abs() <= 0.401));
            }
            prop_assert!(out.len() <= inside.count());
        }
    }

    /// Catches numbers of an earlier pass that are taken for this one's.
    #[test]
    fn passes_do_not_disturb_each_other() {
        let points: Vec<[f32; 2]> =
            (0..500).map(|i| [(i * 7 % 90) as f32 * 0.1, (i % 60) as f32 * 0.1]).collect();
        let thinned = |thinner: &mut Thinner, reach_m, block_m| {
            let mut out = Vec::new();
            thinner.thin(&points, reach_m, block_m, &mut out);
            let mut shared: Vec<_> = points.iter().map(|[x, y]| [*x, *y, 1.0]).collect();
            thinner.share_votes(&mut shared, 50.0, block_m);
            let votes: f32 = shared.iter().map(|[_, _, vote]| vote).sum();
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
