//! What a vehicle had in view.
//!
//! A radar sees up to its returns: a sector of azimuth was in view up to the farthest return in it,
//! for what lies behind a nearer one was evidently seen through or past it. A sector without any
//! return says nothing; there the beam may have met a smooth wall that sent nothing back.
//!
//! Returns are gathered by the view block the radar was in, in sectors of the map around the block's
//! middle, so that neither the number of scans a second nor the cut of a drive into parts matters, and
//! the rays to follow are few. A block of the map was in view when enough of them cross it.

use std::collections::{BTreeMap, HashMap};
use std::f64::consts::TAU;

use super::blocks::{VIEW_BLOCK_CELLS, VIEW_BLOCK_M, VIEW_BLOCKS, VIEW_BLOCKS_PER_SIDE, ViewBlocks};
use crate::geo::{CellIndex, TileId, Zone};
use crate::point::MapPoint;

/// Sectors of azimuth: 3 degrees each.
const SECTORS: usize = 120;
/// Steps along a ray, metres: none of the blocks it crosses by more is missed.
const STEP_M: f64 = VIEW_BLOCK_M / 2.0;
/// Rays that must cross a block. One may be a ghost's; a block that is passed by within range is
/// crossed by dozens.
const MIN_RAYS: u8 = 4;

/// A view block of a zone's plane, counted from the zone's false origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct BlockIndex {
    zone: Zone,
    x: i64,
    y: i64,
}

impl BlockIndex {
    fn of(zone: Zone, point: MapPoint) -> Self {
        let cell = CellIndex::of(point);
        let side = VIEW_BLOCK_CELLS as i64;
        Self { zone, x: cell.x.div_euclid(side), y: cell.y.div_euclid(side) }
    }

    fn middle(self) -> MapPoint {
        [self.x, self.y].map(|v| (v as f64 + 0.5) * VIEW_BLOCK_M).into()
    }

    /// The tile that holds it, and its number there.
    fn in_tile(self) -> (TileId, usize) {
        let side = VIEW_BLOCKS_PER_SIDE as i64;
        let id =
            TileId { zone: self.zone, y: self.y.div_euclid(side) as i32, x: self.x.div_euclid(side) as i32 };
        (id, (self.y.rem_euclid(side) * side + self.x.rem_euclid(side)) as usize)
    }
}

/// The farthest returns, by the block the radar was in and the sector.
#[derive(Debug, Default)]
pub(super) struct Views {
    farthest_m: HashMap<BlockIndex, Box<[f32; SECTORS]>>,
}

/// Rays that crossed each block of some tiles.
type Crossed = BTreeMap<TileId, Box<[u8; VIEW_BLOCKS]>>;

impl Views {
    /// Adds the returns of one radar, which is at `radar`.
    pub(super) fn see(&mut self, zone: Zone, radar: MapPoint, returns: impl Iterator<Item = MapPoint>) {
        let block = BlockIndex::of(zone, radar);
        let middle = block.middle();
        let farthest_m = self.farthest_m.entry(block).or_insert_with(|| Box::new([0.0; SECTORS]));
        for point in returns {
            let (east, north) = (point.x_m - middle.x_m, point.y_m - middle.y_m);
            let turn = (north.atan2(east) / TAU).rem_euclid(1.0);
            let sector = &mut farthest_m[((turn * SECTORS as f64) as usize).min(SECTORS - 1)];
            *sector = sector.max(east.hypot(north) as f32);
        }
    }

    /// What was in view of the tiles that are `known`.
    pub(super) fn observed(&self, known: impl Fn(&TileId) -> bool) -> BTreeMap<TileId, ViewBlocks> {
        let mut crossed = Crossed::new();
        for (block, farthest_m) in &self.farthest_m {
            for (sector, range_m) in farthest_m.iter().enumerate().filter(|(_, range_m)| **range_m > 0.0) {
                follow(*block, sector, f64::from(*range_m), &known, &mut crossed);
            }
        }
        let in_view = |rays: &[u8; VIEW_BLOCKS]| (0..VIEW_BLOCKS).filter(|i| rays[*i] >= MIN_RAYS).collect();
        crossed.into_iter().map(|(id, rays)| (id, in_view(&rays))).collect()
    }
}

/// Counts a ray in every block it crosses.
fn follow(
    from: BlockIndex,
    sector: usize,
    range_m: f64,
    known: &impl Fn(&TileId) -> bool,
    crossed: &mut Crossed,
) {
    let middle = from.middle();
    let (sin, cos) = ((sector as f64 + 0.5) / SECTORS as f64 * TAU).sin_cos();
    let mut last = None;
    // The tile the ray is in: looked up once, for a ray enters two or three.
    let mut here: Option<(TileId, Option<&mut Box<[u8; VIEW_BLOCKS]>>)> = None;
    for step in 0..=(range_m / STEP_M) as usize {
        let along = step as f64 * STEP_M;
        let block = BlockIndex::of(from.zone, middle.moved(along * cos, along * sin));
        if last.replace(block) == Some(block) {
            continue;
        }
        let (id, block) = block.in_tile();
        if here.as_ref().is_none_or(|(at, _)| *at != id) {
            let rays = known(&id).then(|| crossed.entry(id).or_insert_with(|| Box::new([0; VIEW_BLOCKS])));
            here = Some((id, rays));
        }
        if let Some((_, Some(rays))) = &mut here {
            rays[block] = rays[block].saturating_add(1);
        }
    }
}
