//! Prepared windows, kept while memory lasts.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use echofix_core::align::fft::Plans;
use echofix_core::align::{PreparedMap, Search};
use echofix_core::geo::TileId;
use echofix_core::window::{Frame, Window};
use moka::sync::Cache;

use crate::store::{Error, MapStore};

/// A window of the map as it was in certain versions of its tiles: a change makes another key, and
/// the old one is forgotten as the least recently used.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    frame: Frame,
    versions: Arc<[(TileId, u64)]>,
}

/// A window and where it came from.
pub(super) struct Found {
    pub map: Arc<PreparedMap>,
    /// Epoch of the map when it was looked up.
    pub epoch: u64,
    pub cached: bool,
}

/// Windows by their square and the versions of their tiles.
pub(super) struct WindowCache {
    windows: Cache<Key, Arc<PreparedMap>>,
    plans: Mutex<BTreeMap<usize, Arc<Plans>>>,
    search: Search,
}

impl WindowCache {
    pub(super) fn new(capacity_mib: u64, search: Search) -> Self {
        let windows = Cache::builder()
            .weigher(|_, map: &Arc<PreparedMap>| (map.bytes() >> 10) as u32)
            .max_capacity(capacity_mib << 10)
            .build();
        Self { windows, plans: Mutex::default(), search }
    }

    /// The window of a square; `None` where no tile exists. Blocks.
    pub(super) fn get(&self, store: &dyn MapStore, frame: Frame) -> Result<Option<Found>, Arc<Error>> {
        let epoch = store.progress().borrow().epoch;
        let (mut x, mut y) = ((i32::MAX, i32::MIN), (i32::MAX, i32::MIN));
        for tile in frame.tiles() {
            x = (x.0.min(tile.x), x.1.max(tile.x));
            y = (y.0.min(tile.y), y.1.max(tile.y));
        }
        let catalog = store.catalog(frame.zone, x.0..=x.1, y.0..=y.1)?;
        let versions: Arc<[_]> = catalog.iter().map(|info| (info.id, info.version)).collect();
        if versions.is_empty() {
            return Ok(None);
        }
        let mut cached = true;
        let key = Key { frame, versions };
        let map = self.windows.try_get_with_by_ref(&key, || {
            cached = false;
            self.prepare(store, &key)
        })?;
        Ok(Some(Found { map, epoch, cached }))
    }

    fn prepare(&self, store: &dyn MapStore, key: &Key) -> Result<Arc<PreparedMap>, Error> {
        let mut tiles = Vec::with_capacity(key.versions.len());
        for (id, _) in key.versions.iter() {
            if let Some(stored) = store.tile(*id)? {
                tiles.push((*id, stored.tile));
            }
        }
        let window = Window::stitch(key.frame, tiles.iter().map(|(id, tile)| (*id, &**tile)));
        Ok(Arc::new(PreparedMap::new(window, self.plans(key.frame.side), &self.search)))
    }

    fn plans(&self, side: usize) -> Arc<Plans> {
        // A panic while holding the lock leaves a map that is still a map.
        let mut plans = self.plans.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(plans.entry(side).or_insert_with(|| Arc::new(Plans::new(side))))
    }
}
