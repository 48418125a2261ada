//! A batch, thinned: one point for each block that holds any. Ten returns from one lamp post in one
//! batch are not ten witnesses.

/// Side of the blocks that the service thins to, metres.
pub const BLOCK_M: f32 = 0.4;

/// Thins points to one, their mean, for each block of a square grid.
#[derive(Default)]
pub struct Thinner {
    /// For each block a number and the pass that wrote it: what another pass wrote counts as nothing,
    /// so that nothing has to be wiped.
    blocks: Vec<(u32, u32)>,
    pass: u32,
    sums: Vec<[f32; 3]>,
}

impl Thinner {
    /// Writes the means of the points in blocks of `block_m` into `out`: ground metres in the
    /// body's frame, and 1, the vote of each. Points farther than `reach_m` are left out.
    pub fn thin(&mut self, points: &[[f32; 2]], reach_m: f32, block_m: f32, out: &mut Vec<[f32; 3]>) {
        let grid = self.begin(reach_m, block_m);
        self.sums.clear();
        for &[x, y] in points.iter().filter(|[x, y]| x * x + y * y <= reach_m * reach_m) {
            let slot = &mut self.blocks[grid.block(x, y)];
            if slot.1 != self.pass {
                *slot = (self.sums.len() as u32, self.pass);
                self.sums.push([0.0; 3]);
            }
            let sum = &mut self.sums[slot.0 as usize];
            *sum = [sum[0] + x, sum[1] + y, sum[2] + 1.0];
        }
        out.clear();
        out.extend(self.sums.iter().map(|[x, y, n]| [x / n, y / n, 1.0]));
    }

    /// Divides the vote of each block among the points in it. All must lie within `reach_m`.
    pub fn share_votes(&mut self, points: &mut [[f32; 3]], reach_m: f32, block_m: f32) {
        let grid = self.begin(reach_m, block_m);
        for [x, y, _] in points.iter() {
            let slot = &mut self.blocks[grid.block(*x, *y)];
            *slot = if slot.1 == self.pass { (slot.0 + 1, self.pass) } else { (1, self.pass) };
        }
        for [x, y, vote] in points {
            *vote = 1.0 / self.blocks[grid.block(*x, *y)].0 as f32;
        }
    }

    fn begin(&mut self, reach_m: f32, block_m: f32) -> Grid {
        let grid = Grid::new(reach_m, block_m);
        let (next, wrapped) = self.pass.overflowing_add(1);
        if wrapped || self.blocks.len() != grid.blocks() {
            self.blocks.clear();
            self.blocks.resize(grid.blocks(), (0, 0));
        }
        self.pass = next.max(1);
        grid
    }
}

/// Blocks around the body.
struct Grid {
    half: f32,
    per_metre: f32,
    side: usize,
}

impl Grid {
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
}
