//! Tiles as weights, cached while memory lasts.

mod refresher;

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use echofix_core::align::weights::TileWeights;
use echofix_core::geo::TileId;
use echofix_core::tile::Tile;
use echofix_core::window::MapSquare;
use moka::sync::Cache;

use crate::store::{Error, MapStore, TileInfo};
use refresher::Refresher;

/// For how long a tile that changed is used as it was, while it is prepared anew.
const STANDS_IN: Duration = Duration::from_secs(5);

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
    /// An epoch of the map that all of them show.
    pub epoch: u64,
    /// Newest day of the map then.
    pub day: u16,
    /// True when none had to be prepared.
    pub cached: bool,
}

/// Prepared tiles by their versions.
pub(super) struct PreparedTiles {
    known: Arc<Known>,
    refresher: Refresher,
}

/// What is prepared, and what it is prepared from.
pub(super) struct Known {
    store: Arc<dyn MapStore>,
    tiles: Cache<PreparedKey, Arc<TileWeights>>,
    /// The newest that is prepared of each tile.
    latest: Cache<TileId, Arc<Latest>>,
}

/// A tile as it was last prepared.
struct Latest {
    key: PreparedKey,
    tile: Arc<TileWeights>,
    /// The last epoch that it was seen to be of.
    epoch: AtomicU64,
    /// Since when it is known to be older than the map.
    outdated: OnceLock<Instant>,
}

impl Latest {
    fn is(&self, wanted: &PreparedKey) -> bool {
        self.key == *wanted
    }

    /// May it be used in place of other versions for a moment? The map may only have grown since.
    fn stands_in_for(&self, wanted: &PreparedKey) -> bool {
        let grown = self.key.versions.iter().zip(&wanted.versions).all(|(old, new)| old <= new);
        // Another day lets all of the map fade, or no longer.
        grown && self.key.day == wanted.day && self.outdated.get_or_init(Instant::now).elapsed() < STANDS_IN
    }
}

impl PreparedTiles {
    /// Prepares tiles of a store.
    pub(super) fn new(store: Arc<dyn MapStore>, capacity_mib: u64) -> Self {
        let kib = |tile: &TileWeights| (tile.bytes() >> 10) as u32;
        let tiles = Cache::builder()
            .weigher(move |_, tile: &Arc<TileWeights>| kib(tile))
            .max_capacity(capacity_mib << 10)
            .build();
        // Mostly the same tiles, which are held once.
        let latest = Cache::builder()
            .weigher(move |_, latest: &Arc<Latest>| kib(&latest.tile))
            .max_capacity(capacity_mib << 10)
            .build();
        let known = Arc::new(Known { store, tiles, latest });
        Self { refresher: Refresher::of(&known), known }
    }

    /// The tiles of a map window; none where nothing is served. Blocks.
    ///
    /// A tile that has just changed is used as it was while it is prepared anew, behind: a fix must not wait for what others
    /// upload.
    pub(super) fn get(&self, frame: MapSquare) -> Result<PreparedWindow, Arc<Error>> {
        let known = &*self.known;
        let epoch = known.store.progress().borrow().epoch;
        // Before the tiles are read: one of a later day is noticed.
        let day = known.store.totals().newest_day;
        let (mut x, mut y) = ((i32::MAX, i32::MIN), (i32::MAX, i32::MIN));
        for tile in frame.tiles() {
            x = (x.0.min(tile.x), x.1.max(tile.x));
            y = (y.0.min(tile.y), y.1.max(tile.y));
        }
        let catalog = known.store.catalog(frame.zone, x.0 - 1..=x.1 + 1, y.0 - 1..=y.1 + 1)?;
        let mut found = PreparedWindow { tiles: Vec::new(), epoch, day, cached: true };
        let mut reading = Reading::of(&*known.store);
        for id in frame.tiles().filter(|id| version(&catalog, *id) != 0) {
            let key =
                PreparedKey { id, day, versions: id.with_neighbours().map(|near| version(&catalog, near)) };
            let latest = known.latest.get(&id);
            let stands_in = latest
                .filter(|latest| latest.is(&key) || (latest.stands_in_for(&key) && self.refresher.ask(id)));
            if let Some(latest) = stands_in {
                if latest.is(&key) {
                    latest.epoch.fetch_max(epoch, Ordering::Relaxed);
                } else {
                    found.epoch = found.epoch.min(latest.epoch.load(Ordering::Relaxed));
                }
                found.tiles.push(latest.tile.clone());
                continue;
            }
            let (tile, fresh) = known.prepared(&key, epoch, &mut reading)?;
            found.cached &= !fresh;
            found.tiles.push(tile);
        }
        Ok(found)
    }
}

impl Known {
    /// A tile in these versions, and whether it had to be prepared.
    fn prepared(
        &self,
        key: &PreparedKey,
        epoch: u64,
        reading: &mut Reading<'_>,
    ) -> Result<(Arc<TileWeights>, bool), Arc<Error>> {
        let mut fresh = false;
        let tile = self.tiles.try_get_with_by_ref(key, || {
            fresh = true;
            reading.prepare(key)
        })?;
        if reading.is_late {
            // The map moved on meanwhile: right now, and not for the next one who asks by this key.
            self.tiles.invalidate(key);
            return Ok((tile, fresh));
        }
        let latest =
            Latest { key: *key, tile: tile.clone(), epoch: AtomicU64::new(epoch), outdated: OnceLock::new() };
        self.latest.insert(key.id, Arc::new(latest));
        Ok((tile, fresh))
    }

    /// Prepares a tile as it is now.
    fn refresh(&self, id: TileId) -> Result<(), Arc<Error>> {
        let epoch = self.store.progress().borrow().epoch;
        let day = self.store.totals().newest_day;
        let catalog = self.store.catalog(id.zone, id.x - 1..=id.x + 1, id.y - 1..=id.y + 1)?;
        let key = PreparedKey { id, day, versions: id.with_neighbours().map(|near| version(&catalog, near)) };
        self.prepared(&key, epoch, &mut Reading::of(&*self.store)).map(drop)
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

impl<'a> Reading<'a> {
    fn of(store: &'a dyn MapStore) -> Self {
        Self { store, known: HashMap::new(), is_late: false }
    }

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
    use crate::http::testing::{FakeStore, austin};
    use crate::store::testing::some_uploads;
    use crate::store::{EmbeddedStore, MapStatus, Operations, Options, Policy, UploadRecord};
    use echofix_core::evidence::Cell;
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
        let deadline = Instant::now() + Duration::from_secs(20);
        let done = || {
            let now = *progress.borrow();
            now.state == MapStatus::Serving && now.epoch == now.journaled && now.building.is_none()
        };
        while !done() {
            assert!(Instant::now() < deadline);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn around(id: TileId) -> MapSquare {
        MapSquare { zone: id.zone, origin: id.first_cell(), side: CELLS_PER_TILE }
    }

    /// The tiles that a vehicle is localized against, in words.
    fn prepared(cache: &PreparedTiles, id: TileId) -> String {
        let window = cache.get(around(id)).unwrap();
        let told = |tile: &Arc<TileWeights>| format!("{} {} {:?}", tile.id, tile.cells, tile.blocks);
        window.tiles.iter().map(told).collect()
    }

    /// Catches: a prepared tile that stays as it was while the map's newest day moves on, so that a vehicle is localized
    /// against other tiles before a restart than after it; and one that stays faded when that day is taken back.
    #[test]
    fn what_is_localized_against_fades_at_once_and_as_after_a_restart() {
        let dir = tempfile::tempdir().unwrap();
        let store = Arc::new(opened(dir.path()));
        let upload = some_uploads(1).remove(0);
        let id = *upload.contribution.tiles.keys().next().unwrap();
        store.commit(upload.clone()).unwrap();
        caught_up(&store);
        let cache = PreparedTiles::new(store.clone(), 64);
        let fresh = prepared(&cache, id);
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
            let now = prepared(&cache, id);
            assert_eq!(now == fresh, days < 365, "after {days} days");
            assert_eq!(now, prepared(&PreparedTiles::new(store.clone(), 64), id), "with no memory of before");
        }
        store.rollback(1).unwrap();
        caught_up(&store);
        assert_eq!(prepared(&cache, id), fresh, "the later days are taken back");
    }

    fn tile(cells: u32) -> Tile {
        let cell = Cell { hits: 1, passes: 1, contributors: 1, ..Cell::default() };
        Tile::from_cells((0..cells).map(|index| (index * 700, cell)).collect()).unwrap()
    }

    /// Catches: a fix that waits while a tile is prepared which an upload has just changed, and one that uses the old one for ever.
    #[test]
    fn a_tile_that_changed_stands_in_for_itself_for_a_moment() {
        let store = Arc::new(FakeStore::default());
        store.put(austin(), tile(3));
        let tiles = PreparedTiles::new(store.clone(), 64);
        let frame = MapSquare::around(austin().zone, austin().centre(), 1.0, 1.0);
        let first = tiles.get(frame).unwrap();
        assert!(!first.cached && !first.tiles.is_empty());
        store.put(austin(), tile(40));
        // Its version must differ from that of the one before.
        store.touch(austin());
        store.touch(austin());
        let second = tiles.get(frame).unwrap();
        assert!(second.cached, "nothing was prepared in between");
        assert!(second.epoch <= first.epoch);
        let deadline = Instant::now() + Duration::from_secs(20);
        while tiles
            .get(frame)
            .unwrap()
            .tiles
            .iter()
            .zip(&first.tiles)
            .all(|(now, then)| Arc::ptr_eq(now, then))
        {
            assert!(Instant::now() < deadline, "the new one never comes");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn what_was_taken_back_or_is_old_stands_in_for_nothing() {
        let (store, now) = (FakeStore::default(), Instant::now());
        store.put(austin(), tile(1));
        let weights = Arc::new(TileWeights::packed(austin(), |_| None));
        let key = |versions| PreparedKey { id: austin(), day: 3, versions };
        let latest = |outdated: OnceLock<Instant>| Latest {
            key: key([5; 9]),
            tile: weights.clone(),
            epoch: AtomicU64::new(5),
            outdated,
        };
        let mut gone = key([6; 9]);
        assert!(latest(OnceLock::new()).stands_in_for(&gone));
        assert!(!latest(OnceLock::new()).stands_in_for(&PreparedKey { day: 4, ..gone }), "of another day");
        gone.versions[3] = 0;
        assert!(!latest(OnceLock::new()).stands_in_for(&gone));
        let long_ago = now.checked_sub(STANDS_IN).unwrap();
        assert!(!latest(OnceLock::from(long_ago)).stands_in_for(&key([6; 9])));
    }
}
