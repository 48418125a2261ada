//! Tiles as weights, cached while memory lasts.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use echofix_core::align::weights::TileWeights;
use echofix_core::geo::TileId;
use echofix_core::tile::Tile;
use echofix_core::window::MapSquare;
use moka::policy::EvictionPolicy;
use moka::sync::Cache;

use crate::store::{Error, MapStore, TileInfo, UpcomingMap};

/// A tile as it was in certain versions of it and its eight neighbours, whose hits reach across its
/// borders (0 where there is none): a change makes another key, and the old one is forgotten as the
/// least recently used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct PreparedKey {
    id: TileId,
    /// Newest day of the map, by which evidence fades.
    day: u16,
    versions: [u64; 9],
}

/// The tiles of a map window.
pub(super) struct PreparedWindow {
    pub tiles: Vec<Arc<TileWeights>>,
    /// Epoch of the map when they were looked up.
    pub epoch: u64,
    /// Newest day of the map then.
    pub day: u16,
    /// True when none had to be prepared.
    pub cached: bool,
}

/// The tiles of a map window, as ranges east and north.
pub(super) fn block(frame: MapSquare) -> (RangeInclusive<i32>, RangeInclusive<i32>) {
    let (mut x, mut y) = ((i32::MAX, i32::MIN), (i32::MAX, i32::MIN));
    for tile in frame.tiles() {
        x = (x.0.min(tile.x), x.1.max(tile.x));
        y = (y.0.min(tile.y), y.1.max(tile.y));
    }
    (x.0..=x.1, y.0..=y.1)
}

/// A tile for which somebody asked within this time is prepared again before its next version is served.
const ASKED_WITHIN: Duration = Duration::from_mins(1);
/// Tiles that are, at most: those asked for last. Some hundreds lie around ten vehicles.
const PREPARED_AHEAD: u64 = 512;

/// Prepared tiles by their versions.
pub(super) struct PreparedTiles {
    tiles: Cache<PreparedKey, Arc<TileWeights>>,
    /// Those that somebody asked for of late.
    asked: Cache<TileId, ()>,
    hits: AtomicU64,
    misses: AtomicU64,
}

/// What prepared tiles are in memory, and how often they were.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CacheFigures {
    /// Bytes they take, by estimate.
    pub bytes: u64,
    /// Tiles that were asked for and there.
    pub hits: u64,
    /// Tiles that were asked for and had to be prepared.
    pub misses: u64,
}

impl PreparedTiles {
    pub(super) fn new(capacity_mib: u64) -> Self {
        let tiles = Cache::builder()
            .weigher(|_, tile: &Arc<TileWeights>| (tile.bytes() >> 10) as u32)
            .max_capacity(capacity_mib << 10)
            // Old versions are asked for no more, however often they were.
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let asked = Cache::builder().max_capacity(PREPARED_AHEAD).eviction_policy(EvictionPolicy::lru());
        let asked = asked.time_to_idle(ASKED_WITHIN).build();
        Self { tiles, asked, hits: AtomicU64::new(0), misses: AtomicU64::new(0) }
    }

    pub(super) fn figures(&self) -> CacheFigures {
        CacheFigures {
            bytes: self.tiles.weighted_size() << 10,
            hits: self.hits.load(Ordering::Relaxed),
            misses: self.misses.load(Ordering::Relaxed),
        }
    }

    /// The tiles of a map window; none where nothing is served. Blocks.
    pub(super) fn get(&self, store: &dyn MapStore, frame: MapSquare) -> Result<PreparedWindow, Arc<Error>> {
        let epoch = store.progress().borrow().epoch;
        // Before the tiles are read: one of a later day is noticed.
        let day = store.newest_day();
        let (x, y) = block(frame);
        let catalog = store.catalog(frame.zone, x.start() - 1..=x.end() + 1, y.start() - 1..=y.end() + 1)?;
        let mut found = PreparedWindow { tiles: Vec::new(), epoch, day, cached: true };
        let mut reading = Reading { store, known: HashMap::new(), is_late: false };
        let versions = |id| version(&catalog, id);
        for id in frame.tiles().filter(|id| versions(*id) != 0) {
            let key = PreparedKey::of(id, day, versions);
            self.asked.get_with(id, || ());
            let mut is_there = true;
            let tile = self.tiles.try_get_with_by_ref(&key, || {
                is_there = false;
                reading.prepare(&key)
            })?;
            found.cached &= is_there;
            let counted = if is_there { &self.hits } else { &self.misses };
            counted.fetch_add(1, Ordering::Relaxed);
            if reading.is_late {
                // The map moved on meanwhile: right now, and not for the next one who asks by this key.
                self.tiles.invalidate(&key);
            }
            found.tiles.push(tile);
        }
        Ok(found)
    }

    /// Prepares what will be served, as far as it was asked for of late: nobody on the road waits for it then.
    pub(super) fn prepare_ahead(&self, upcoming: &dyn UpcomingMap) {
        let day = upcoming.newest_day();
        let asked: BTreeSet<TileId> = self.asked.iter().map(|(id, ())| *id).collect();
        let mut known = BTreeMap::new();
        for id in asked.into_iter().take_while(|_| upcoming.goes_on()) {
            let key = PreparedKey::of(id, day, |id| upcoming.version(id));
            if upcoming.version(id) == 0 || self.tiles.contains_key(&key) {
                continue;
            }
            // Row by row: what lies south of its neighbours is needed no more.
            known.retain(|near: &TileId, _| near.zone == id.zone && near.y >= id.y - 1);
            let near = id.with_neighbours();
            let unknown: Vec<_> = near.into_iter().filter(|near| !known.contains_key(near)).collect();
            let read = unknown.into_iter().map(|near| Ok((near, upcoming.tile(near)?)));
            match read.collect::<Result<Vec<_>, Error>>() {
                Ok(read) => known.extend(read),
                Err(error) => {
                    // Who asks for it is told.
                    tracing::debug!(%error, "a tile could not be prepared");
                    continue;
                }
            }
            let weights = TileWeights::packed(id, |near| known.get(&near)?.as_deref());
            self.tiles.insert(key, Arc::new(weights));
        }
    }
}

impl PreparedKey {
    fn of(id: TileId, day: u16, version: impl Fn(TileId) -> u64) -> Self {
        Self { id, day, versions: id.with_neighbours().map(version) }
    }
}

fn version(catalog: &[TileInfo], id: TileId) -> u64 {
    catalog.iter().find(|info| info.id == id).map_or(0, |info| info.version)
}

/// Tiles that are read for one square: those side by side have neighbours in common, and each is read once.
struct Reading<'a> {
    store: &'a dyn MapStore,
    known: HashMap<TileId, Option<Arc<Tile>>>,
    /// A tile was read that is newer than its key says.
    is_late: bool,
}

impl Reading<'_> {
    fn prepare(&mut self, key: &PreparedKey) -> Result<Arc<TileWeights>, Error> {
        let near = key.id.with_neighbours().into_iter().zip(key.versions);
        for (id, version) in near.filter(|(_, version)| *version != 0) {
            if let Entry::Vacant(unknown) = self.known.entry(id) {
                let stored = self.store.tile(id)?;
                let same =
                    stored.as_ref().is_some_and(|stored| (stored.version, stored.day) == (version, key.day));
                self.is_late |= !same;
                unknown.insert(stored.map(|stored| stored.tile));
            }
        }
        Ok(Arc::new(TileWeights::packed(key.id, |id| self.known.get(&id)?.as_deref())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::testing::some_uploads;
    use crate::store::{EmbeddedStore, MapStatus, Operations, Options, Policy, UploadRecord};
    use echofix_core::geo::CELLS_PER_TILE;
    use echofix_core::tile::Decay;
    use std::path::Path;
    use uuid::Uuid;

    /// A map that fades, of these uploads.
    fn opened(dir: &Path) -> EmbeddedStore {
        let policy = Policy { decay: Some(Decay::default()), ..Policy::trusting() };
        let options =
            Options { cache_bytes: 1 << 20, segment_bytes: 1 << 20, ..Options::new(dir.into(), policy) };
        EmbeddedStore::open(&options).unwrap()
    }

    fn caught_up(store: &EmbeddedStore) {
        let progress = store.progress();
        let deadline = std::time::Instant::now() + Duration::from_secs(20);
        let done = || {
            let now = *progress.borrow();
            now.state == MapStatus::Serving && now.epoch == now.journaled && now.building.is_none()
        };
        while !done() {
            assert!(std::time::Instant::now() < deadline);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn around(id: TileId) -> MapSquare {
        MapSquare { zone: id.zone, origin: id.first_cell(), side: CELLS_PER_TILE }
    }

    /// The tiles that a vehicle is localized against, in words.
    fn prepared(cache: &PreparedTiles, store: &dyn MapStore, id: TileId) -> String {
        let window = cache.get(store, around(id)).unwrap();
        let told = |tile: &Arc<TileWeights>| format!("{} {} {:?}", tile.id, tile.cells, tile.blocks);
        window.tiles.iter().map(told).collect()
    }

    /// Catches: a prepared tile that stays as it was while the map's newest day moves on, so that a vehicle is localized
    /// against other tiles before a restart than after it; and one that stays faded when that day is taken back.
    #[test]
    fn what_is_localized_against_fades_at_once_and_as_after_a_restart() {
        let dir = tempfile::tempdir().unwrap();
        let store = opened(dir.path());
        let upload = some_uploads(1).remove(0);
        let id = *upload.contribution.tiles.keys().next().unwrap();
        store.commit(upload.clone()).unwrap();
        caught_up(&store);
        let cache = PreparedTiles::new(64);
        let fresh = prepared(&cache, &store, id);
        // The same at another place, 200 and then 500 days later.
        let elsewhere = |days| {
            let mut later: UploadRecord = upload.clone();
            later.id = Uuid::from_u128(u128::from(days));
            later.pass.day += days;
            let moved = |id: TileId| TileId { x: id.x + 1000, ..id };
            let tiles = later.contribution.tiles.into_iter();
            later.contribution.tiles = tiles.map(|(id, evidence)| (moved(id), evidence)).collect();
            later
        };
        for days in [200_u16, 500] {
            store.commit(elsewhere(days)).unwrap();
            caught_up(&store);
            let now = prepared(&cache, &store, id);
            assert_eq!(now == fresh, days < 365, "after {days} days");
            assert_eq!(now, prepared(&PreparedTiles::new(64), &store, id), "with no memory of before");
        }
        store.rollback(1).unwrap();
        caught_up(&store);
        assert_eq!(prepared(&cache, &store, id), fresh, "the later days are taken back");
    }

    /// Catches: a fix that waits until the tiles around it are prepared, because somebody uploaded there or a decision was taken;
    /// and tiles prepared ahead that are others than those that are served.
    #[test]
    fn what_is_asked_for_is_prepared_before_it_is_served() {
        let dir = tempfile::tempdir().unwrap();
        let store = opened(dir.path());
        let cache = Arc::new(PreparedTiles::new(64));
        let ahead = Arc::clone(&cache);
        store.before_serving(Box::new(move |upcoming| ahead.prepare_ahead(upcoming)));
        let uploads = some_uploads(3);
        let ids: BTreeSet<TileId> =
            uploads.iter().flat_map(|u| u.contribution.tiles.keys().copied()).collect();
        store.commit(uploads[0].clone()).unwrap();
        caught_up(&store);
        let is_there = |id: &TileId| cache.get(&store, around(*id)).unwrap().cached;
        let first: Vec<_> = ids.iter().map(is_there).collect();
        assert!(first.contains(&false), "nobody asked for them before");
        let asked = |id: &TileId| {
            assert!(is_there(id), "{id} had to be prepared");
            assert_eq!(prepared(&cache, &store, *id), prepared(&PreparedTiles::new(64), &store, *id));
        };
        for number in [1, 2] {
            store.commit(uploads[number].clone()).unwrap();
            caught_up(&store);
            // Those of the uploads before were there to be asked for.
            let before: BTreeSet<_> =
                uploads[..number].iter().flat_map(|u| u.contribution.tiles.keys()).collect();
            before.into_iter().for_each(asked);
            for id in &ids {
                let _ = is_there(id);
            }
        }
        let mut later = uploads[0].clone();
        (later.id, later.pass.day) = (Uuid::from_u128(77), later.pass.day + 200);
        store.commit(later).unwrap();
        caught_up(&store);
        ids.iter().for_each(asked);
        store.rollback(2).unwrap();
        caught_up(&store);
        ids.iter().for_each(asked);
    }
}
