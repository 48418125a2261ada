//! What fixes can be expected to be, place by place; kept while memory lasts.
//!
//! Computed for those who look at the map, one tile at a time and on one thread: a vehicle that asks where
//! it is never waits for it.

use std::sync::{Arc, Mutex, PoisonError};

use echofix_core::align::Search;
use echofix_core::align::localizability::{Assessor, Expected, Localizability, REACH_M};
use echofix_core::align::verdict::Integrity;
use echofix_core::geo::{CELLS_PER_TILE, TILE_M, TileId};
use echofix_core::window::MapSquare;
use moka::sync::Cache;

use super::cache::TileCache;
use crate::store::{Error, MapStore, TileInfo};

/// Places along a tile's side: a batch reaches several times as far as from one to the next.
pub const PLACES: usize = 2;
/// Side of the square that a place stands for, metres.
const PLACE_M: f64 = TILE_M / PLACES as f64;
/// Tiles kept.
const KEPT: u64 = 100_000;
/// Memory for prepared tiles, MiB: a tile and its neighbours, and what the next ones share with it.
const TILE_CACHE_MIB: u64 = 32;

/// A tile as it was in certain versions of it and of the tiles around it, two deep: those within reach, and
/// those whose hits reach across their borders (0 where there is none).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Key {
    id: TileId,
    versions: [u64; 25],
}

/// What fixes in a tile can be expected to be.
#[derive(Debug, Clone, PartialEq)]
pub struct TileExpectation {
    /// The newest version of a tile that it rests on: the tile itself and those within reach of a fix.
    pub version: u64,
    /// By place, row by row from the south-west.
    places: [Localizability; PLACES * PLACES],
}

impl TileExpectation {
    /// Its places as (column, row, what can be expected there).
    pub fn places(&self) -> impl Iterator<Item = (usize, usize, &Localizability)> {
        self.places.iter().enumerate().map(|(i, place)| (i % PLACES, i / PLACES, place))
    }

    /// What can be expected at the place that stands for map metres in the tile.
    #[must_use]
    pub fn at(&self, id: TileId, place: [f64; 2]) -> &Localizability {
        let origin = id.origin();
        let index = |axis: usize| (((place[axis] - origin[axis]) / PLACE_M) as usize).min(PLACES - 1);
        &self.places[index(1) * PLACES + index(0)]
    }
}

/// Tells what fixes can be expected to be.
pub struct Expectations {
    store: Arc<dyn MapStore>,
    search: Search,
    integrity: Integrity,
    tiles: TileCache,
    known: Cache<Key, Arc<TileExpectation>>,
    assessor: Mutex<Assessor>,
}

impl Expectations {
    /// Of fixes on a map that are searched and judged in this way.
    #[must_use]
    pub fn new(store: Arc<dyn MapStore>, search: Search, integrity: Integrity) -> Self {
        // From any of its places, the tile and its neighbours are all that is looked at.
        let most_m = TILE_M + 0.5 * PLACE_M - REACH_M;
        Self {
            store,
            search: Search { extent_m: search.extent_m.min(most_m), ..search },
            integrity,
            tiles: TileCache::new(TILE_CACHE_MIB),
            known: Cache::new(KEPT),
            assessor: Mutex::default(),
        }
    }

    /// What fixes in a tile can be expected to be; `None` where nothing is known of it and its neighbours.
    /// Takes a while where that is not known yet; blocks.
    ///
    /// # Errors
    /// When the map cannot be read.
    pub fn tile(&self, id: TileId) -> Result<Option<Arc<TileExpectation>>, Arc<Error>> {
        let catalog = self.store.catalog(id.zone, id.x - 2..=id.x + 2, id.y - 2..=id.y + 2)?;
        if !catalog.iter().any(|tile| near(tile.id, id)) {
            return Ok(None);
        }
        let key = Key { id, versions: versions(&catalog, id) };
        if let Some(known) = self.known.get(&key) {
            return Ok(Some(known));
        }
        // One at a time: whoever waited for the same tile finds it known.
        // A panic while holding the lock leaves buffers that the next assessment fills anew.
        let mut assessor = self.assessor.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = self.known.get(&key) {
            return Ok(Some(known));
        }
        let frame = square(id);
        let found = self.tiles.get(&*self.store, frame)?;
        let origin = id.origin();
        let places = std::array::from_fn(|i| {
            let middle = [i % PLACES, i / PLACES].map(|step| (step as f64 + 0.5) * PLACE_M);
            let place = [origin[0] + middle[0], origin[1] + middle[1]];
            assessor.assess(frame, &found.tiles, place, &self.search, &self.integrity)
        });
        let version = key.versions.iter().copied().max().unwrap_or_default();
        let made = Arc::new(TileExpectation { version, places });
        self.known.insert(key, Arc::clone(&made));
        Ok(Some(made))
    }

    /// What a fix will most likely be told.
    #[must_use]
    pub fn verdict(&self, expected: &Localizability) -> Expected {
        expected.expected(&self.integrity)
    }
}

/// A tile and its neighbours.
fn square(id: TileId) -> MapSquare {
    let south_west = TileId { x: id.x - 1, y: id.y - 1, ..id };
    MapSquare { zone: id.zone, origin: south_west.first_cell(), side: 3 * CELLS_PER_TILE }
}

fn near(a: TileId, b: TileId) -> bool {
    a.x.abs_diff(b.x) <= 1 && a.y.abs_diff(b.y) <= 1
}

/// Versions of a tile and of those around it, two deep, row by row.
fn versions(catalog: &[TileInfo], id: TileId) -> [u64; 25] {
    std::array::from_fn(|i| {
        let at = TileId { x: id.x + i as i32 % 5 - 2, y: id.y + i as i32 / 5 - 2, ..id };
        catalog.iter().find(|info| info.id == at).map_or(0, |info| info.version)
    })
}
