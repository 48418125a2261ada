//! How well does a contribution agree with the map that exists?

use echofix_core::agreement::PointIndex;
use echofix_core::geo::{CELL_M, CELLS_PER_TILE, TileId};
use echofix_core::tile::Tile;

use super::Contributed;
use crate::store::{Error, MapStore};

/// A detection agrees with the map when it has a mapped point within this distance, metres.
const RADIUS_M: f64 = 0.5;
/// Cells of the contribution that are asked about.
const SAMPLE: usize = 2_000;
/// Tiles of the map that are read for it, at most.
const MAX_TILES: usize = 64;

/// Share of a contribution's cells that lie on structure the map already has, 0 to 1; `None`
/// where the map has no tile yet. Cells in new tiles are left out; of a long way, some tiles are asked.
///
/// # Errors
/// When a tile cannot be read.
pub fn agreement(store: &dyn MapStore, contributed: &Contributed) -> Result<Option<f64>, Error> {
    let (mut map, mut asked) = (Vec::new(), Vec::new());
    let own = |id: &TileId| contributed.own_zones.contains(&id.zone);
    let own_tiles: Vec<_> = contributed.contribution.tiles.iter().filter(|(id, _)| own(id)).collect();
    for &(id, share) in spread(&own_tiles, MAX_TILES) {
        if let Some(stored) = store.tile(*id)? {
            map.extend(mapped(*id, &stored.tile));
            asked.extend(share.cells.iter().map(|cell| place(*id, cell.index, cell.centroid())));
        }
    }
    if asked.is_empty() {
        return Ok(None);
    }
    let sample = spread(&asked, SAMPLE).copied();
    Ok(Some(PointIndex::new(map).matched_fraction(sample, RADIUS_M)))
}

/// At most so many items, evenly spread over all.
fn spread<T>(items: &[T], most: usize) -> impl Iterator<Item = &T> {
    items.iter().step_by(items.len().div_ceil(most).max(1))
}

/// Map metres of a tile's points.
fn mapped(id: TileId, tile: &Tile) -> impl Iterator<Item = [f64; 2]> + '_ {
    tile.cells().iter().map(move |(index, cell)| place(id, *index, cell.centroid()))
}

/// Map metres of a place in a cell.
fn place(id: TileId, index: u32, within: [f64; 2]) -> [f64; 2] {
    let side = CELLS_PER_TILE as u32;
    let [x0, y0] = id.origin();
    let metres = |cell: u32, within: f64| (f64::from(cell) + within) * CELL_M;
    [x0 + metres(index % side, within[0]), y0 + metres(index / side, within[1])]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_bounded_and_reaches_far() {
        for count in [0, 1, 63, 64, 65, 127, 4_096] {
            let items: Vec<usize> = (0..count).collect();
            let sample: Vec<_> = spread(&items, MAX_TILES).collect();
            assert!(sample.len() <= MAX_TILES && sample.is_empty() == items.is_empty(), "{count}");
            assert!(sample.last().is_none_or(|last| **last >= count / 2), "{count}");
        }
    }
}
