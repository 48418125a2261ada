//! An upload's cells, moved onto the map.

use std::collections::BTreeMap;

use super::{Offsets, TileHits};
use crate::datum::Offset;
use crate::evidence::{self, CellHits, OFFSET_STEPS};
use crate::geo::{CELL_M, CellIndex, TileId};
use crate::point::MapPoint;

/// Moves cells by the offset at their position: each goes whole, with the mean position of its hits, into the cell
/// that holds the new position, be it another tile's. Hits are conserved.
#[must_use]
pub fn moved(tiles: &[TileHits], offsets: &Offsets) -> BTreeMap<TileId, Vec<CellHits>> {
    let mut moved: BTreeMap<TileId, BTreeMap<u32, CellHits>> = BTreeMap::new();
    for (id, cells) in tiles {
        for cell in cells.iter().filter(|cell| cell.hits > 0) {
            let (to, hits) = shifted(*id, cell, offsets);
            let (tile, index) = TileId::locate(id.zone, to);
            let empty = CellHits { index, hits: 0, offset_sum: [0, 0] };
            let sum = moved.entry(tile).or_default().entry(index).or_insert(empty);
            sum.hits = sum.hits.saturating_add(hits.hits);
            for axis in 0..2 {
                sum.offset_sum[axis] = sum.offset_sum[axis].saturating_add(hits.offset_sum[axis]);
            }
        }
    }
    moved.into_iter().map(|(id, cells)| (id, cells.into_values().collect())).collect()
}

/// The cell that a cell's hits move to, and their offsets in it.
fn shifted(id: TileId, cell: &CellHits, offsets: &Offsets) -> (CellIndex, CellHits) {
    let from = id.cell(cell.index);
    let steps = i64::from(OFFSET_STEPS);
    let hits = i64::from(cell.hits);
    let mean = cell.offset_sum.map(|sum| f64::from(sum) / f64::from(cell.hits) / f64::from(OFFSET_STEPS));
    let position = MapPoint::new((from.x as f64 + mean[0]) * CELL_M, (from.y as f64 + mean[1]) * CELL_M);
    let by = offsets.at(position);
    let axis = |from: i64, sum: u32, by_m: f64| {
        let by_steps = (by_m / CELL_M * f64::from(OFFSET_STEPS)).round() as i64;
        let sum = i64::from(sum) + hits * by_steps;
        let cells = sum.div_euclid(hits * steps);
        // A mean less than a step from the next cell stays in this one.
        (from + cells, (sum - cells * hits * steps).min(hits * (steps - 1)) as u32)
    };
    let (x, east) = axis(from.x, cell.offset_sum[0], by.x_m);
    let (y, north) = axis(from.y, cell.offset_sum[1], by.y_m);
    (CellIndex { x, y }, CellHits { offset_sum: [east, north], ..*cell })
}

/// The evidence of an upload in one zone, in order of its tiles, moved onto the map; each tile's with the offset
/// at the tile's centre. What was in view is not moved: its blocks are coarser than any offset.
#[must_use]
pub fn moved_evidence(
    shares: &[(TileId, &evidence::TileEvidence)],
    offsets: &Offsets,
) -> Vec<(TileId, evidence::TileEvidence, Offset)> {
    if offsets.is_empty() {
        return shares.iter().map(|(id, share)| (*id, (*share).clone(), Offset::default())).collect();
    }
    let cells: Vec<_> = shares.iter().map(|(id, share)| (*id, &share.cells[..])).collect();
    let on_map = moved(&cells, offsets).into_iter().map(|(id, cells)| {
        let mut share = evidence::TileEvidence::of_hits(cells);
        if let Ok(before) = shares.binary_search_by_key(&id, |(id, _)| *id) {
            share.observed = share.observed.union(&shares[before].1.observed);
        }
        (id, share, Offset::of(&offsets.at(id.centre())))
    });
    on_map.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::Zone;
    use proptest::prelude::*;

    fn id() -> TileId {
        TileId { zone: Zone::from_epsg(32614).expect("a zone"), y: 64_000, x: 11_000 }
    }

    fn cells() -> impl Strategy<Value = Vec<CellHits>> {
        let cell = (1..9_u32, 0..256_u32, 0..256_u32);
        prop::collection::btree_map(0..512 * 512_u32, cell, 1..60).prop_map(|cells| {
            let cell = |(index, (hits, x, y))| CellHits { index, hits, offset_sum: [hits * x, hits * y] };
            cells.into_iter().map(cell).collect()
        })
    }

    fn by(east_mm: i32, north_mm: i32, yaw_urad: i32) -> Offsets {
        let mut offsets = Offsets::default();
        offsets.push(id().origin().moved(25.0, 25.0), Offset { east_mm, north_mm, yaw_urad }, 1.0);
        offsets
    }

    /// Hits, and the sum of their positions in steps, counted from the tile's corner.
    fn moments(tiles: &BTreeMap<TileId, Vec<CellHits>>) -> [i64; 3] {
        let mut sums = [0; 3];
        for (tile, cells) in tiles {
            let zero = id().first_cell();
            for cell in cells {
                let CellIndex { x, y } = tile.cell(cell.index);
                let hits = i64::from(cell.hits);
                sums[0] += hits;
                sums[1] += i64::from(cell.offset_sum[0]) + 256 * hits * (x - zero.x);
                sums[2] += i64::from(cell.offset_sum[1]) + 256 * hits * (y - zero.y);
            }
        }
        sums
    }

    proptest! {
        /// Catches: cells lost or doubled at a tile's border, offsets cut off, hits forgotten where two cells
        /// come to lie in one.
        #[test]
        fn hits_are_conserved_and_go_where_they_were_sent(
            cells in cells(), east_mm in -900..900_i32, north_mm in -900..900_i32,
        ) {
            let before = BTreeMap::from([(id(), cells.clone())]);
            let after = moved(&[(id(), &cells)], &by(east_mm, north_mm, 0));
            let (a, b) = (moments(&before), moments(&after));
            prop_assert_eq!(a[0], b[0]);
            for (axis, mm) in [(1, east_mm), (2, north_mm)] {
                let steps = (b[axis] - a[axis]) as f64 / a[0] as f64;
                prop_assert!((steps - 2.56 * f64::from(mm)).abs() < 1.5, "{} {}", steps, mm);
            }
            for cells in after.values() {
                prop_assert!(cells.windows(2).all(|w| w[0].index < w[1].index));
                prop_assert!(cells.iter().all(|c| c.index < 512 * 512));
                prop_assert!(cells.iter().all(|c| c.offset_sum.iter().all(|o| *o <= 255 * c.hits)));
            }
        }

        #[test]
        fn nothing_moves_without_an_offset(cells in cells()) {
            prop_assert_eq!(moved(&[(id(), &cells)], &Offsets::default()), BTreeMap::from([(id(), cells)]));
        }
    }

    #[test]
    fn a_turn_moves_what_is_far_from_its_middle() {
        let at = |x: u32, y: u32| CellHits { index: y * 512 + x, hits: 2, offset_sum: [256, 256] };
        let after = moved(&[(id(), &[at(250, 250), at(450, 250)])], &by(0, 0, 10_000));
        // 20 m east of the middle a turn by 0.01 is 20 cm north.
        let places: Vec<_> = after[&id()].iter().map(|c| (c.index % 512, c.index / 512)).collect();
        assert_eq!(places, [(250, 250), (450, 252)]);
    }
}
