//! How well does a contribution agree with the map that exists?

use echofix_core::agreement::PointIndex;
use echofix_core::evidence::Contribution;
use echofix_core::geo::{CELL_M, CELLS_PER_TILE, TileId};
use echofix_core::tile::Tile;

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
pub fn agreement(store: &dyn MapStore, contribution: &Contribution) -> Result<Option<f64>, Error> {
    let (mut map, mut asked) = (Vec::new(), Vec::new());
    let tiles: Vec<_> = contribution.tiles.iter().collect();
    for &(id, share) in spread(&tiles, MAX_TILES) {
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

    #[test]
    fn agreement_tells_a_good_upload_from_a_shifted_one() {
        use crate::store::{EmbeddedStore, Options, Policy, State, Upload};
        use echofix_core::evidence::{CellHits, Pass, Share};
        use echofix_core::geo::Zone;
        let dir = tempfile::tempdir().unwrap();
        let options =
            Options { data_dir: dir.path().to_owned(), segment_bytes: 1 << 20, policy: Policy::trusting() };
        let store = EmbeddedStore::open(&options).unwrap();
        let id = TileId { zone: Zone::from_epsg(32614).unwrap(), y: 65_000, x: 12_000 };
        // A wall along a row of cells.
        let wall = |row: u32| {
            let hit = |x| CellHits { index: 512 * row + x, hits: 1, offset_sum: [128, 128] };
            let share = Share::of_hits((100..300).map(hit).collect());
            Contribution { tiles: [(id, share)].into(), detections: 200 }
        };
        assert_eq!(agreement(&store, &wall(50)).unwrap(), None, "there is no map yet");
        let pass = Pass { day: 1, contributor: 1 };
        let (id, contribution) = (uuid::Uuid::nil(), wall(50));
        store.commit(Upload { id, pass, forget_before: 0, contribution, answer: vec![] }).unwrap();
        let mut progress = store.progress();
        let folded = |p: &crate::store::Progress| p.state == State::Serving && p.epoch == 1;
        while !folded(&progress.borrow_and_update()) {
            std::thread::yield_now();
        }
        assert_eq!(agreement(&store, &wall(50)).unwrap(), Some(1.0));
        assert_eq!(agreement(&store, &wall(80)).unwrap(), Some(0.0), "it lies 3 m beside");
    }
}
