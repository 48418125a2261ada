//! Localizability: what a fix can be expected to be, on a grid of spots; cached while memory lasts.
//!
//! Computed for those who look at the map, one tile at a time and on one thread: a vehicle that asks where
//! it is never waits for it.

use std::ops::RangeInclusive;
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::time::Duration;

use echofix_core::align::Search;
use echofix_core::align::localizability::{Assessor, Expected, Localizability, REACH_M};
use echofix_core::align::verdict::Integrity;
use echofix_core::geo::{CELLS_PER_TILE, TILE_M, TileId};
use echofix_core::point::MapPoint;
use echofix_core::window::MapSquare;
use moka::sync::Cache;

use super::prepared_tiles::PreparedTiles;
use crate::patience::Patience;
use crate::store::{Error, MapStore, TileInfo};

/// Spots along a tile's side: a batch reaches several times as far as from one to the next.
pub const SPOTS_PER_SIDE: usize = 2;
const SPOTS: usize = SPOTS_PER_SIDE * SPOTS_PER_SIDE;
/// How often a caller that waits for others looks whether it still should.
const LOOK_AGAIN: Duration = Duration::from_millis(2);
/// Side of the square that a spot stands for, metres.
const SPOT_M: f64 = TILE_M / SPOTS_PER_SIDE as f64;
/// Tiles whose expectations are cached.
const CACHED_TILES: u64 = 100_000;
/// Memory for prepared tiles, MiB: a tile and its neighbours, and what the next ones need of it, too.
const TILE_CACHE_MIB: u64 = 32;

/// A tile as it was in certain versions of it and of the tiles around it, two deep: those within reach, and
/// those whose hits reach across their borders (0 where there is none).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct ExpectationKey {
    id: TileId,
    /// Newest day of the map, by which evidence fades.
    day: u16,
    versions: [u64; 25],
}

/// What fixes in a tile can be expected to be.
#[derive(Debug, Clone, PartialEq)]
pub struct TileExpectation {
    /// The newest version of a tile that it rests on: the tile itself and those within reach of a fix.
    pub version: u64,
    /// Spot by spot, row by row from the south-west.
    spots: Vec<Localizability>,
}

impl TileExpectation {
    /// Its spots as (column, row, what can be expected there).
    pub fn spots(&self) -> impl Iterator<Item = (usize, usize, &Localizability)> {
        self.spots.iter().enumerate().map(|(i, spot)| (i % SPOTS_PER_SIDE, i / SPOTS_PER_SIDE, spot))
    }

    /// What can be expected at the spot that stands for a position in the tile.
    #[must_use]
    pub fn at(&self, id: TileId, at: MapPoint) -> &Localizability {
        let origin = id.origin();
        let index = |along_m: f64| ((along_m / SPOT_M) as usize).min(SPOTS_PER_SIDE - 1);
        &self.spots[index(at.y_m - origin.y_m) * SPOTS_PER_SIDE + index(at.x_m - origin.x_m)]
    }
}

/// Why there is no expectation.
#[derive(Debug, thiserror::Error)]
pub enum NotAssessed {
    /// The map cannot be read.
    #[error(transparent)]
    Store(#[from] Arc<Error>),
    /// Nobody waits for it any more.
    #[error("the caller no longer waits")]
    Gone,
}

impl From<Error> for NotAssessed {
    fn from(error: Error) -> Self {
        Self::Store(Arc::new(error))
    }
}

/// Assesses what fixes can be expected to be.
pub struct Expectations {
    store: Arc<dyn MapStore>,
    search: Search,
    integrity: Integrity,
    tiles: PreparedTiles,
    known: Cache<ExpectationKey, Arc<TileExpectation>>,
    assessor: Mutex<Assessor>,
    judged: String,
}

impl Expectations {
    /// Of fixes on a map that are searched and judged in this way.
    #[must_use]
    pub fn new(store: Arc<dyn MapStore>, search: Search, integrity: Integrity) -> Self {
        // From any of its spots, no more than the tile and its neighbours is needed.
        let most_m = TILE_M + 0.5 * SPOT_M - REACH_M;
        let search = Search { extent_m: search.extent_m.min(most_m), ..search };
        Self {
            store,
            judged: format!("{search:?} {integrity:?}"),
            search,
            integrity,
            tiles: PreparedTiles::new(TILE_CACHE_MIB),
            known: Cache::new(CACHED_TILES),
            assessor: Mutex::default(),
        }
    }

    /// How fixes are searched and judged, in a text that is equal where that is.
    #[must_use]
    pub fn judged(&self) -> &str {
        &self.judged
    }

    /// The same questions to another map.
    #[must_use]
    pub fn over(&self, store: Arc<dyn MapStore>) -> Self {
        Self::new(store, self.search, self.integrity)
    }

    /// What fixes in a tile can be expected to be; `None` where nothing is known of it and its neighbours.
    /// Takes a while where that is not known yet; blocks, but no longer than the caller waits.
    ///
    /// # Errors
    /// When the map cannot be read, or the caller is gone.
    pub fn tile(&self, id: TileId, patience: &Patience) -> Result<Option<Arc<TileExpectation>>, NotAssessed> {
        // Before all that is read: what is read of a later day is not remembered as of this one.
        let day = self.store.totals().newest_day;
        let catalog = self.store.catalog(id.zone, around(id.x), around(id.y))?;
        if !catalog.iter().any(|tile| near(tile.id, id)) {
            return Ok(None);
        }
        let key = ExpectationKey { id, day, versions: versions(&catalog, id) };
        if let Some(known) = self.known.get(&key) {
            return Ok(Some(known));
        }
        // One at a time: a caller that waited for the same tile finds it cached.
        let mut assessor = self.assessor(patience)?;
        if let Some(known) = self.known.get(&key) {
            return Ok(Some(known));
        }
        let frame = square(id);
        let found = self.tiles.get(&*self.store, frame)?;
        let origin = id.origin();
        let mut spots = Vec::with_capacity(SPOTS);
        for i in 0..SPOTS {
            if patience.is_over() {
                return Err(NotAssessed::Gone);
            }
            let middle = [i % SPOTS_PER_SIDE, i / SPOTS_PER_SIDE].map(|step| (step as f64 + 0.5) * SPOT_M);
            let at = origin.moved(middle[0], middle[1]);
            spots.push(assessor.assess(frame, &found.tiles, at, &self.search, &self.integrity));
        }
        let version = key.versions.iter().copied().max().unwrap_or_default();
        let made = Arc::new(TileExpectation { version, spots });
        if found.day == day {
            self.known.insert(key, Arc::clone(&made));
        }
        Ok(Some(made))
    }

    /// The assessor, once nobody else uses it.
    fn assessor(&self, patience: &Patience) -> Result<MutexGuard<'_, Assessor>, NotAssessed> {
        loop {
            match self.assessor.try_lock() {
                Ok(assessor) => return Ok(assessor),
                // A panic while holding the lock leaves buffers that the next assessment fills anew.
                Err(TryLockError::Poisoned(assessor)) => return Ok(assessor.into_inner()),
                Err(TryLockError::WouldBlock) if patience.is_over() => return Err(NotAssessed::Gone),
                Err(TryLockError::WouldBlock) => std::thread::sleep(LOOK_AGAIN),
            }
        }
    }

    /// The verdict that a fix will most likely get.
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

/// Two tiles to either side, as far as numbers reach.
fn around(at: i32) -> RangeInclusive<i32> {
    at.saturating_sub(2)..=at.saturating_add(2)
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
