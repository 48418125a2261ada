//! The map as weights: smoothed to the sensor's noise, logarithmic, a byte a cell.
//!
//! `log(1 + smoothed mass / knee)` neither saturates after a few hits, as occupancy does, nor lets
//! one bright cell outvote a wall. A cell's mass is the hits that a pass with it in view makes, on
//! average ([`crate::evidence::Cell::mass`]): a crowd's map weighs what a single survey's does, and what stands
//! weighs more than what was there once. Bytes keep sums exact, so that every engine
//! finds the same maximum, and empty squares are not kept (`packed`).

use super::packed::{PackedWeights, SQUARE};
use super::smoothing::{self, CellMass, HALO};
use crate::buckets::PointBuckets;
use crate::datum::Datum;
use crate::geo::{CELLS_PER_TILE, TILE_M, TileId};
use crate::near::NearPoints;
use crate::point::MapPoint;
use crate::tile::Tile;

pub use super::smoothing::STEPS;

/// Cells along the side of a coarse cell.
pub const COARSE: usize = SQUARE;
/// Cells along the side of a square of which it is known whether the map has been there.
pub const KNOWN: usize = 8;
/// The map has been where it has anything so many of these squares away at most, 3.2 m: as far as things stand
/// apart along a street.
const KNOWN_REACH: i64 = 4;

const SIDE: usize = CELLS_PER_TILE;

/// A block of [`COARSE`] x [`COARSE`] cells with any hits: a possible source of one vote of a batch. In six bytes, since a
/// tile has a thousand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OccupiedBlock {
    /// Mean position of its hits east and north of the tile's south-west corner, in 65536ths of the tile's side.
    at: [u16; 2],
    /// Its hits in one of the passes that saw it, in 256ths.
    hits: u16,
}

impl OccupiedBlock {
    /// Of a mean position in cells.
    fn new(at: [f32; 2], hits: f32) -> Self {
        const STEPS: f32 = 65536.0 / SIDE as f32;
        Self { at: at.map(|cells| (cells * STEPS) as u16), hits: (hits * 256.0) as u16 }
    }

    /// Mean position of its hits, metres east of the tile's south-west corner.
    #[must_use]
    pub fn east_m(&self) -> f64 {
        f64::from(self.at[0]) * (TILE_M / 65536.0)
    }

    /// The same, metres north of it.
    #[must_use]
    pub fn north_m(&self) -> f64 {
        f64::from(self.at[1]) * (TILE_M / 65536.0)
    }

    /// Its hits in one of the passes that saw it; no more than 255.
    #[must_use]
    pub fn hits(&self) -> f64 {
        f64::from(self.hits) / 256.0
    }
}

/// The points of a tile and its borders.
enum Points {
    Exact(PointBuckets),
    Packed(NearPoints),
}

/// One tile, ready to be aligned against; made of its hits and those just beyond its borders.
pub struct TileWeights {
    /// The tile.
    pub id: TileId,
    weights: PackedWeights,
    /// For each square of [`KNOWN`] x [`KNOWN`] cells a bit, set where the map has been; a word a row.
    known: Box<[u64]>,
    points: Points,
    /// What stands in the tile itself, block by block.
    pub blocks: Box<[OccupiedBlock]>,
    /// Occupied cells of the tile itself.
    pub cells: usize,
    /// Last UTC day anything was seen in it, counted from the Unix epoch.
    pub newest_day: u16,
    /// What its contributions were moved by.
    pub datum: Datum,
    /// See [`Tile::mean_passes`].
    pub passes: f64,
}

impl TileWeights {
    /// Weighs a tile exactly, for folding, which must give the same map for ever; `tile_at` gives it and its eight neighbours,
    /// where they exist.
    #[must_use]
    pub fn new<'a>(id: TileId, tile_at: impl Fn(TileId) -> Option<&'a Tile>) -> Self {
        Self::with(id, tile_at, |masses| {
            Points::Exact(PointBuckets::new(id, masses.iter().map(|mass| mass.at)))
        })
    }

    /// Weighs a tile in fewer bytes, for localizing: what is near is known to half a cell.
    #[must_use]
    pub fn packed<'a>(id: TileId, tile_at: impl Fn(TileId) -> Option<&'a Tile>) -> Self {
        Self::with(id, tile_at, |masses| {
            Points::Packed(NearPoints::new(id, masses.iter().map(|mass| mass.at)))
        })
    }

    fn with<'a>(
        id: TileId,
        tile_at: impl Fn(TileId) -> Option<&'a Tile>,
        points: impl FnOnce(&[CellMass]) -> Points,
    ) -> Self {
        let empty = Tile::default();
        let own = tile_at(id).unwrap_or(&empty);
        let masses = around(id, &tile_at);
        Self {
            id,
            weights: PackedWeights::of(&smoothing::weights(&masses)),
            known: known(id, &tile_at),
            points: points(&masses),
            blocks: blocks(own),
            cells: own.len(),
            newest_day: own.newest_day(),
            datum: own.datum(),
            passes: own.mean_passes(),
        }
    }

    /// The weights, [`STEPS`] to a unit of the logarithm.
    pub(super) fn weights(&self) -> &PackedWeights {
        &self.weights
    }

    /// For each row of squares of [`KNOWN`] x [`KNOWN`] cells those where the map has been, the westernmost in the lowest bit.
    pub(super) fn known(&self) -> &[u64] {
        &self.known
    }

    /// Is a point of the map within so many metres of a position in the tile?
    #[must_use]
    pub fn is_near(&self, position: MapPoint, radius_m: f64) -> bool {
        match &self.points {
            Points::Exact(points) => points.is_near(position, radius_m),
            Points::Packed(points) => points.is_near(position, radius_m),
        }
    }

    /// Bytes held, approximately.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let points = match &self.points {
            Points::Exact(points) => points.bytes(),
            Points::Packed(points) => points.bytes(),
        };
        self.weights.bytes()
            + points
            + size_of_val(&*self.known)
            + size_of_val(&*self.blocks)
            + size_of::<Self>()
    }
}

/// Cells of a tile and of its neighbours' borders: mean position of the hits, and their mass.
fn around<'a>(id: TileId, tile_at: &impl Fn(TileId) -> Option<&'a Tile>) -> Vec<CellMass> {
    let side = SIDE as i64;
    let inside = -HALO..side + HALO;
    let mut masses = Vec::new();
    for (dy, dx) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))) {
        let neighbour = TileId { y: id.y + dy, x: id.x + dx, ..id };
        let Some(tile) = tile_at(neighbour) else { continue };
        let first = [i64::from(dx) * side, i64::from(dy) * side];
        // Cells are in the order of their rows: of a neighbour few are looked at.
        let before =
            |y: i64| tile.cells().partition_point(|(index, _)| i64::from(*index) / side + first[1] < y);
        let near = &tile.cells()[before(inside.start)..before(inside.end)];
        masses.extend(near.iter().filter_map(|(index, cell)| {
            let (x, y) = (first[0] + i64::from(*index) % side, first[1] + i64::from(*index) / side);
            inside.contains(&x).then(|| {
                let [fx, fy] = cell.centroid();
                CellMass { at: [x as f64 + fx, y as f64 + fy], mass: cell.mass() as f32 }
            })
        }));
    }
    masses
}

/// Where the map has been: squares that have anything near them, in the tile or beyond its border.
fn known<'a>(id: TileId, tile_at: &impl Fn(TileId) -> Option<&'a Tile>) -> Box<[u64]> {
    const SQUARES: i64 = (SIDE / KNOWN) as i64;
    const _: () = assert!(SQUARES == 64);
    let mut known = vec![0_u64; SQUARES as usize];
    let mut marked = vec![false; ((SQUARES + 2 * KNOWN_REACH) * (SQUARES + 2 * KNOWN_REACH)) as usize];
    for (dy, dx) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))) {
        let Some(tile) = tile_at(TileId { y: id.y + dy, x: id.x + dx, ..id }) else { continue };
        for (index, _) in tile.cells() {
            let square = |cell: i64, tile: i32| cell / KNOWN as i64 + i64::from(tile) * SQUARES;
            let x = square(i64::from(*index) % SIDE as i64, dx);
            let y = square(i64::from(*index) / SIDE as i64, dy);
            let reach = -KNOWN_REACH..SQUARES + KNOWN_REACH;
            if !(reach.contains(&x) && reach.contains(&y)) {
                continue;
            }
            let wide = SQUARES + 2 * KNOWN_REACH;
            let mark = &mut marked[((y + KNOWN_REACH) * wide + x + KNOWN_REACH) as usize];
            if std::mem::replace(mark, true) {
                continue;
            }
            let (from, to) = ((x - KNOWN_REACH).max(0), (x + KNOWN_REACH + 1).min(SQUARES));
            let columns = (from..to).fold(0_u64, |columns, column| columns | 1 << column);
            for row in (y - KNOWN_REACH).max(0)..(y + KNOWN_REACH + 1).min(SQUARES) {
                known[row as usize] |= columns;
            }
        }
    }
    known.into_boxed_slice()
}

/// The occupied blocks of a tile, row by row.
fn blocks(tile: &Tile) -> Box<[OccupiedBlock]> {
    const BLOCKS: usize = SIDE / COARSE;
    let mut sums = vec![[0.0_f32; 4]; BLOCKS * BLOCKS];
    for (index, cell) in tile.cells() {
        let (x, y) = (*index as usize % SIDE, *index as usize / SIDE);
        let ([fx, fy], hits) = (cell.centroid(), cell.hits as f32);
        let sum = &mut sums[y / COARSE * BLOCKS + x / COARSE];
        let more = [
            hits * (x as f32 + fx as f32),
            hits * (y as f32 + fy as f32),
            hits,
            hits / cell.passes.max(1) as f32,
        ];
        *sum = std::array::from_fn(|i| sum[i] + more[i]);
    }
    let occupied = sums.into_iter().filter(|[_, _, hits, _]| *hits > 0.0);
    occupied.map(|[x, y, hits, of_a_pass]| OccupiedBlock::new([x / hits, y / hits], of_a_pass)).collect()
}

/// Their mean, of [`COARSE`] x [`COARSE`] cells, rounded up so that a trace of structure is not lost.
pub(super) fn mean(weights: impl Iterator<Item = u8>) -> u8 {
    rounded(weights.map(u16::from).sum())
}

fn rounded(sum: u16) -> u8 {
    sum.div_ceil((COARSE * COARSE) as u16) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::packed::tests::unpacked;
    use crate::evidence::Cell;
    use crate::evidence::presence::ALWAYS;
    use crate::geo::Zone;

    fn id() -> TileId {
        TileId { zone: Zone::from_epsg(32614).unwrap(), y: 100, x: 200 }
    }

    fn tile(cells: &[(u32, [u32; 2])]) -> Tile {
        let cell = |offset: [u32; 2]| Cell {
            hits: 4,
            passes: 1,
            presence: ALWAYS,
            offset_sum: offset.map(|o| 4 * o),
            ..Cell::default()
        };
        Tile::from_cells(cells.iter().map(|(index, offset)| (*index, cell(*offset))).collect()).unwrap()
    }

    fn fine(weights: &TileWeights) -> Vec<u8> {
        unpacked(weights.weights())
    }

    #[test]
    fn the_weight_is_highest_where_the_hits_were_and_falls_off_evenly() {
        let hit = tile(&[(30 * 512 + 20, [128, 128])]);
        let weights = TileWeights::new(id(), |at| (at == id()).then_some(&hit));
        let fine = fine(&weights);
        let at = |x: usize, y: usize| fine[y * 512 + x];
        assert_eq!(fine.iter().max(), Some(&at(20, 30)));
        // A kernel's centre is rounded to an eighth of a cell.
        assert!(at(18, 30).abs_diff(at(22, 30)) <= 2 && at(20, 28).abs_diff(at(20, 32)) <= 2);
        assert!(at(20, 30) > at(22, 30) && at(22, 30) > at(24, 30) && at(40, 30) == 0);
    }

    #[test]
    fn structure_on_a_border_is_smoothed_across_it() {
        let east = TileId { x: 201, ..id() };
        let hit = tile(&[(30 * 512, [0, 128])]);
        let find = |at| (at == east).then_some(&hit);
        let (west, own) = (TileWeights::new(id(), find), TileWeights::new(east, find));
        let (fine_west, fine) = (fine(&west), fine(&own));
        let difference = i32::from(fine_west[30 * 512 + 511]) - i32::from(fine[30 * 512]);
        assert!(difference.abs() <= 2 && fine[30 * 512] > 0, "{difference}");
        assert_eq!((west.cells, own.cells), (0, 1));
    }

    /// Catches: packing that grows a tile, or that knows of other points.
    #[test]
    fn a_packed_tile_is_small_and_near_the_same_points() {
        let hits: Vec<_> = (0..400).map(|at| (at * 512 + 17 + at % 3, [at % 256, 90])).collect();
        let hits = tile(&hits);
        let find = |at| (at == id()).then_some(&hits);
        let (exact, packed) = (TileWeights::new(id(), find), TileWeights::packed(id(), find));
        assert!(packed.bytes() < exact.bytes(), "{} of {}", packed.bytes(), exact.bytes());
        assert!(packed.bytes() * 6 < CELLS_PER_TILE * CELLS_PER_TILE, "{}", packed.bytes());
        let along = |i: u32| id().origin().moved(f64::from(i % 60) * 0.09, f64::from(i / 60) * 0.17);
        let same = (0..12_000).filter(|i| exact.is_near(along(*i), 0.3) == packed.is_near(along(*i), 0.3));
        assert!(same.count() > 11_500);
    }

    #[test]
    fn a_block_keeps_where_it_is_and_how_often_it_is_hit() {
        let block = OccupiedBlock::new([511.9, 17.3], 3.7);
        assert!((block.east_m() - 51.19).abs() < 1e-3 && (block.north_m() - 1.73).abs() < 1e-3);
        assert!((block.hits() - 3.7).abs() < 0.01);
        assert!((OccupiedBlock::new([0.0, 0.0], 1e6).hits() - 256.0).abs() < 0.01, "it is bounded");
    }
}
