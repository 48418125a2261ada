//! Parts of an upload, each as large as a batch.

use super::TileHits;
use crate::evidence::{CellHits, OFFSET_STEPS};
use crate::geo::{CELL_M, CELLS_PER_TILE, TileId, Zone};
use crate::point::{BodyPoint, MapPoint};

/// A part of an upload.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadPart {
    /// The zone of its cells.
    pub zone: Zone,
    /// Its middle; turns are about it.
    pub middle: MapPoint,
    /// Its cells' mean positions in the frame of a body at its middle that heads east.
    pub points: Vec<BodyPoint>,
}

/// Cuts an upload of one zone into parts around about every second tile, those with most cells first.
#[must_use]
pub fn parts(tiles: &[TileHits], extent_m: f64) -> Vec<UploadPart> {
    let mut by_cells: Vec<&TileHits> = tiles.iter().filter(|(_, cells)| !cells.is_empty()).collect();
    by_cells.sort_by_key(|(id, cells)| (std::cmp::Reverse(cells.len()), *id));
    let mut chosen: Vec<&TileHits> = Vec::new();
    for tile in by_cells {
        let apart = |other: &&TileHits| (other.0.x - tile.0.x).abs().max((other.0.y - tile.0.y).abs()) > 1;
        if chosen.iter().all(apart) {
            chosen.push(tile);
        }
    }
    chosen.into_iter().map(|tile| part_around(tile, tiles, extent_m)).collect()
}

fn part_around((id, cells): &TileHits, tiles: &[TileHits], extent_m: f64) -> UploadPart {
    let (mut middle, count) = (MapPoint::default(), cells.len().max(1) as f64);
    for cell in *cells {
        let at = position(*id, cell);
        middle = middle.moved(at.x_m / count, at.y_m / count);
    }
    let near = |tile: &&TileHits| {
        let gap = |a: i32, b: i32| f64::from((a - b).abs() - 1) * CELLS_PER_TILE as f64 * CELL_M;
        tile.0.zone == id.zone && gap(tile.0.x, id.x).max(gap(tile.0.y, id.y)) < extent_m
    };
    let mut points = Vec::new();
    for (id, cells) in tiles.iter().filter(near) {
        points.extend(cells.iter().filter_map(|cell| {
            let at = position(*id, cell);
            let (dx, dy) = (at.x_m - middle.x_m, at.y_m - middle.y_m);
            (dx * dx + dy * dy <= extent_m * extent_m).then_some(BodyPoint::new(dx as f32, dy as f32))
        }));
    }
    UploadPart { zone: id.zone, middle, points }
}

/// Mean position of a cell's hits.
fn position(id: TileId, cell: &CellHits) -> MapPoint {
    let side = CELLS_PER_TILE as u32;
    let mean = |sum: u32| (f64::from(sum) / f64::from(cell.hits.max(1)) + 0.5) / f64::from(OFFSET_STEPS);
    let [fx, fy] = cell.offset_sum.map(mean);
    let (column, row) = (f64::from(cell.index % side), f64::from(cell.index / side));
    id.origin().moved((column + fx) * CELL_M, (row + fy) * CELL_M)
}
