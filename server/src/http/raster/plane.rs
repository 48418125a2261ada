//! A zone's evidence under a view, pooled by maximum.

use echofix_core::geo::{CELL_M, CELLS_PER_TILE, TileId};
use echofix_core::point::MapPoint;

use super::Spot;

/// log2 of the cells along a tile's side.
pub const TILE_SHIFT: u32 = CELLS_PER_TILE.trailing_zeros();

/// A rectangle of square blocks of 2^`shift` cells, each as strong as its strongest cell.
pub struct Plane {
    shift: u32,
    /// The south-west block.
    first: [i64; 2],
    width: usize,
    spots: Vec<Spot>,
}

impl Plane {
    /// An empty plane that covers the map from `low` to `high`.
    pub fn new(low: MapPoint, high: MapPoint, shift: u32) -> Self {
        let (low, high) = (<[f64; 2]>::from(low), <[f64; 2]>::from(high));
        let block = |metres: f64| ((metres / CELL_M).floor() as i64) >> shift;
        // One more all around: a sample looks at its neighbours.
        let first = low.map(|m| block(m) - 1);
        let count = [0, 1].map(|axis| (block(high[axis]) + 1 - first[axis] + 1) as usize);
        Self { shift, first, width: count[0], spots: vec![Spot::NOTHING; count[0] * count[1]] }
    }

    /// log2 of the cells along a block's side: the largest blocks that are no wider than `pixel_m`.
    pub fn shift_for(pixel_m: f64) -> u32 {
        (pixel_m / CELL_M).log2().floor().max(0.0) as u32
    }

    /// log2 of the cells along a block's side.
    pub fn shift(&self) -> u32 {
        self.shift
    }

    /// Adds what was found in blocks of 2^`shift` cells of a tile, given as (column, row, spot); a
    /// coarser plane pools them, a finer one spreads them.
    pub fn add(&mut self, tile: TileId, shift: u32, found: impl Iterator<Item = (u32, u32, Spot)>) {
        let corner = tile.first_cell();
        for (column, row, spot) in found {
            let cell = [corner.x + (i64::from(column) << shift), corner.y + (i64::from(row) << shift)];
            let low = cell.map(|c| c >> self.shift);
            let spread = 1 << shift.saturating_sub(self.shift);
            for y in low[1]..low[1] + spread {
                for x in low[0]..low[0] + spread {
                    if let Some(here) = self.index([x, y]) {
                        self.spots[here].raise(spot);
                    }
                }
            }
        }
    }

    /// What a pixel of width `pixel_m` around a point shows.
    ///
    /// Blocks no wider than a pixel are pooled two by two, so that no block falls between pixels.
    pub fn sample(&self, point: MapPoint, pixel_m: f64) -> Spot {
        let block_m = CELL_M * f64::from(1_u32 << self.shift);
        let (u, v) = (point.x_m / block_m, point.y_m / block_m);
        if block_m > pixel_m {
            return self.get([u.floor() as i64, v.floor() as i64]);
        }
        let (west, south) = ((u - 0.5).floor() as i64, (v - 0.5).floor() as i64);
        let mut spot = Spot::NOTHING;
        for block in [[west, south], [west + 1, south], [west, south + 1], [west + 1, south + 1]] {
            spot.raise(self.get(block));
        }
        spot
    }

    fn get(&self, block: [i64; 2]) -> Spot {
        self.index(block).map_or(Spot::NOTHING, |i| self.spots[i])
    }

    fn index(&self, block: [i64; 2]) -> Option<usize> {
        let x = usize::try_from(block[0] - self.first[0]).ok().filter(|x| *x < self.width)?;
        let y = usize::try_from(block[1] - self.first[1]).ok()?;
        let index = y * self.width + x;
        (index < self.spots.len()).then_some(index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::geo::Zone;
    use proptest::prelude::*;

    const SPOT: Spot = Spot { level: 200, day: 7 };

    fn tile() -> TileId {
        TileId { zone: Zone::from_epsg(32614).unwrap(), x: 12_000, y: 65_000 }
    }

    proptest! {
        #[test]
        fn no_cell_falls_between_pixels(column in 0..512_u32, row in 0..512_u32, pixel_m in 0.1..20.0_f64, dx in 0.0..1.0, dy in 0.0..1.0) {
            let corner = tile().origin();
            let mut plane = Plane::new(corner, corner.moved(51.2, 51.2), Plane::shift_for(pixel_m));
            plane.add(tile(), 0, std::iter::once((column, row, SPOT)));
            // Pixels at any offset, along both axes.
            let n = (51.2 / pixel_m) as i32 + 2;
            let hit = (-1..n).flat_map(|j| (-1..n).map(move |i| (i, j))).any(|(i, j)| {
                let at = corner.moved((f64::from(i) + dx) * pixel_m, (f64::from(j) + dy) * pixel_m);
                plane.sample(at, pixel_m) == SPOT
            });
            prop_assert!(hit);
        }
    }

    #[test]
    fn a_coarse_block_fills_the_finer_blocks_under_it() {
        let corner = tile().origin();
        let mut plane = Plane::new(corner, corner.moved(51.2, 51.2), 7);
        plane.add(tile(), TILE_SHIFT, std::iter::once((0, 0, SPOT)));
        assert_eq!(plane.spots.iter().filter(|s| **s == SPOT).count(), 16);
        assert_eq!(plane.sample(corner.moved(0.1, 0.1), 1.0), SPOT);
        assert_eq!(plane.sample(corner.moved(-0.1, 0.1), 1.0), Spot::NOTHING);
        assert_eq!(plane.sample(corner.moved(51.1, 51.1), 1.0), SPOT);
        assert_eq!(plane.sample(corner.moved(51.3, 51.1), 1.0), Spot::NOTHING);
    }
}
