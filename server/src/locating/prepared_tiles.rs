//! Tiles as weights, cached while memory lasts.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;

use echofix_core::align::weights::TileWeights;
use echofix_core::geo::TileId;
use echofix_core::tile::Tile;
use echofix_core::window::MapSquare;
use moka::sync::Cache;

use crate::store::{Error, MapStore, TileInfo};

/// A tile as it was in certain versions of it and its eight neighbours, whose hits reach across its
/// borders (0 where there is none): a change makes another key, and the old one is forgotten as the
/// least recently used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct PreparedKey {
    id: TileId,
    versions: [u64; 9],
}

/// The tiles of a map window.
pub(super) struct PreparedWindow {
    pub tiles: Vec<Arc<TileWeights>>,
    /// Epoch of the map when they were looked up.
    pub epoch: u64,
    /// True when none had to be prepared.
    pub cached: bool,
}

/// Prepared tiles by their versions.
pub(super) struct PreparedTiles {
    tiles: Cache<PreparedKey, Arc<TileWeights>>,
}

impl PreparedTiles {
    pub(super) fn new(capacity_mib: u64) -> Self {
        let tiles = Cache::builder()
            .weigher(|_, tile: &Arc<TileWeights>| (tile.bytes() >> 10) as u32)
            .max_capacity(capacity_mib << 10)
            .build();
        Self { tiles }
    }

    /// The tiles of a map window; none where nothing is served. Blocks.
    pub(super) fn get(&self, store: &dyn MapStore, frame: MapSquare) -> Result<PreparedWindow, Arc<Error>> {
        let epoch = store.progress().borrow().epoch;
        let (mut x, mut y) = ((i32::MAX, i32::MIN), (i32::MAX, i32::MIN));
        for tile in frame.tiles() {
            x = (x.0.min(tile.x), x.1.max(tile.x));
            y = (y.0.min(tile.y), y.1.max(tile.y));
        }
        let catalog = store.catalog(frame.zone, x.0 - 1..=x.1 + 1, y.0 - 1..=y.1 + 1)?;
        let mut found = PreparedWindow { tiles: Vec::new(), epoch, cached: true };
        let mut reading = Reading { store, known: HashMap::new() };
        for id in frame.tiles().filter(|id| version(&catalog, *id) != 0) {
            let key = PreparedKey { id, versions: id.with_neighbours().map(|near| version(&catalog, near)) };
            let tile = self.tiles.try_get_with_by_ref(&key, || {
                found.cached = false;
                reading.prepare(&key)
            })?;
            found.tiles.push(tile);
        }
        Ok(found)
    }
}

fn version(catalog: &[TileInfo], id: TileId) -> u64 {
    catalog.iter().find(|info| info.id == id).map_or(0, |info| info.version)
}

/// Tiles that are read for one square: those side by side have neighbours in common, and each is read once.
struct Reading<'a> {
    store: &'a dyn MapStore,
    known: HashMap<TileId, Option<Arc<Tile>>>,
}

impl Reading<'_> {
    fn prepare(&mut self, key: &PreparedKey) -> Result<Arc<TileWeights>, Error> {
        let near = key.id.with_neighbours().into_iter().zip(key.versions);
        for (id, _) in near.filter(|(_, version)| *version != 0) {
            if let Entry::Vacant(unknown) = self.known.entry(id) {
                unknown.insert(self.store.tile(id)?.map(|stored| stored.tile));
            }
        }
        Ok(Arc::new(TileWeights::packed(key.id, |id| self.known.get(&id)?.as_deref())))
    }
}
