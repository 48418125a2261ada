//! The map on the vehicle: tiles on disk that are downloaded once and updated.
//!
//! [`TileCache::sync`] reports to the service which versions the cache has of the tiles that are wanted
//! ([`Want`]: an area, a route, tiles by their ids), takes what changed, and removes what the map no longer
//! holds. [`TileCache::tile`] reads a tile without the network.
//!
//! [`TileCache::sync_layer`] takes the vehicle layer of the tiles instead, a sixth to an eightieth of the bytes and all that localizing needs.
//!
//! A cache is a folder: `<EPSG code>/<x>_<y>_<version>.tile` or `.layer`, each file a tile as it came, in its checksummed
//! codec. A file appears whole or not at all, so that the folder is sound whenever the process ends:
//!
//! - **a crash** leaves a file under another ending, or a tile in two versions; opening removes either;
//! - **a damaged file** is noticed when it is read, and removed: the next `sync` fetches it again;
//! - **full**: the tiles that were not used for longest go first, but none that the same `sync` wants;
//! - **a sync that breaks off** leaves what came; the next one goes on from there.
//!
//! Versions are those of one service: give each service's map a folder of its own.
//!
//! ```no_run
//! use echofix_client::service::ServiceAddress;
//! use echofix_client::tiles::{TileCacheLimits, TileCache, Want};
//! # async fn drive(route: &[echofix_core::geo::LatLon]) -> Result<(), Box<dyn std::error::Error>> {
//! let cache = TileCache::open("/var/lib/echofix/tiles", TileCacheLimits::default())?;
//! let service = ServiceAddress::at("http://127.0.0.1:50051").endpoint()?;
//! let done = cache.sync(&service, &Want::along(route, 100.0)?).await?;
//! println!("{} tiles in {} bytes, {} were up to date", done.fetched, done.bytes, done.unchanged);
//! # Ok(())
//! # }
//! ```

mod assembly;
mod files;
mod index;
mod name;
mod sync;
mod want;

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use echofix_core::geo::TileId;
use echofix_core::tile::{self, DecodeError, Tile};

use crate::disk;
use crate::refusal::CallError;
use index::CacheIndex;
use name::{Form, TileVersionName};

pub use sync::Synced;
pub use want::Want;

/// How much a cache may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileCacheLimits {
    /// Bytes of its tiles.
    pub max_bytes: u64,
}

impl Default for TileCacheLimits {
    /// A gigabyte: the streets of a large city.
    fn default() -> Self {
        Self { max_bytes: 1 << 30 }
    }
}

/// Why the cache cannot do as asked. What it held before is there still.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The service cannot be reached or refuses; what came before stays.
    #[error(transparent)]
    Call(#[from] CallError),
    /// The service's answer is not what the contract says.
    #[error("the service's answer breaks the contract: {0}; update the older of the two")]
    Contract(&'static str),
    /// A tile came that cannot be read.
    #[error("tile {id} came from the service and cannot be read: {source}")]
    Unreadable {
        /// The tile.
        id: TileId,
        /// Why it cannot be decoded.
        source: DecodeError,
    },
    /// The tiles wanted are more than the cache may hold.
    #[error(
        "the tiles wanted do not fit the cache {}, which may hold {max_bytes} bytes; raise the limit or ask \
         for fewer", .dir.display()
    )]
    Full {
        /// The cache's folder.
        dir: PathBuf,
        /// Bytes the cache may hold, at most.
        max_bytes: u64,
    },
    /// Another process has the cache open.
    #[error("the tile cache {} is in use by another process; give each its own folder", .dir.display())]
    InUse {
        /// The cache's folder.
        dir: PathBuf,
    },
    /// A folder of something else.
    #[error("{} holds `{entry}` and no tiles: it is no tile cache; give it an empty folder, or a new one", .dir.display())]
    Foreign {
        /// The folder.
        dir: PathBuf,
        /// Something in it that is not of a cache.
        entry: String,
    },
    /// The file system refuses.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file or folder of the cache.
        path: PathBuf,
        /// The error of the file system.
        source: io::Error,
    },
}

/// Tiles on disk; cheap to clone. All but [`TileCache::sync`] block on the disk.
#[derive(Debug, Clone)]
pub struct TileCache {
    inner: Arc<CacheInner>,
}

#[derive(Debug)]
struct CacheInner {
    dir: PathBuf,
    limits: TileCacheLimits,
    index: Mutex<CacheIndex>,
    /// Whoever holds it writes tiles.
    syncing: tokio::sync::Mutex<()>,
    /// Held as long as the cache is open.
    _lock: File,
}

impl TileCache {
    /// Opens a cache, or makes one; the tiles of earlier runs are in it.
    ///
    /// # Errors
    /// When another process has it open, it is a folder of something else, or the file system refuses.
    pub fn open(dir: impl Into<PathBuf>, limits: TileCacheLimits) -> Result<Self, Error> {
        let dir = dir.into();
        std::fs::create_dir_all(&dir).map_err(io_error(&dir))?;
        files::refuse_foreign(&dir)?;
        let path = dir.join("lock");
        let lock = disk::lock(&path).map_err(io_error(&path))?;
        let lock = lock.ok_or_else(|| Error::InUse { dir: dir.clone() })?;
        let index = Mutex::new(files::scan(&dir)?);
        let inner = CacheInner { dir, limits, index, syncing: tokio::sync::Mutex::default(), _lock: lock };
        // The limit may have been lowered.
        inner.make_room(None, u64::MAX)?;
        Ok(Self { inner: Arc::new(inner) })
    }

    /// A tile with its version, or what its vehicle layer tells of it; `None` when the cache does not have it, or when its file was damaged, which is
    /// removed then.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn tile(&self, id: TileId) -> Result<Option<(u64, Tile)>, Error> {
        let CacheInner { dir, .. } = &*self.inner;
        loop {
            let Some(name) = self.inner.index().touch(id) else { return Ok(None) };
            let path = name.path(dir);
            let damage = match files::read(&path) {
                Ok(encoded) => match decode(name.form, &encoded) {
                    Ok(tile) => return Ok(Some((name.version, tile))),
                    Err(damage) => damage.to_string(),
                },
                // Replaced meanwhile.
                Err(e)
                    if e.kind() == io::ErrorKind::NotFound && self.inner.index().name(id) != Some(name) =>
                {
                    continue;
                }
                Err(e) if e.kind() == io::ErrorKind::NotFound => "the file has vanished".to_owned(),
                Err(source) => return Err(Error::Io { path, source }),
            };
            tracing::warn!(%id, damage, "a cached tile is damaged and will be fetched again");
            self.inner.index().forget(name);
            files::remove(&path)?;
        }
    }

    /// The version of a tile that the cache has.
    #[must_use]
    pub fn version(&self, id: TileId) -> Option<u64> {
        self.inner.index().version(id)
    }

    /// The tiles that the cache has, with their versions.
    #[must_use]
    pub fn versions(&self) -> Vec<(TileId, u64)> {
        self.inner.index().versions().collect()
    }

    /// Bytes of the tiles that the cache has.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.inner.index().bytes()
    }
}

impl CacheInner {
    /// Takes a version of a tile, which replaces the one that is there. Tiles that were used at `since` or later make
    /// no room for it. Returns how many did.
    fn put(&self, name: TileVersionName, encoded: &[u8], since: u64) -> Result<u32, Error> {
        let (path, bytes) = (name.path(&self.dir), encoded.len() as u64);
        let replaced = self.index().name(name.id);
        let evicted = self.make_room(Some((name.id, bytes)), since)?;
        let zone = files::zone_folder(&self.dir, name.id)?;
        files::write(&zone, &path, encoded).map_err(io_error(&path))?;
        self.index().insert(name, bytes);
        // Only now: whenever the process ends, there is one that is whole.
        match replaced.filter(|old| *old != name) {
            Some(old) => files::remove(&old.path(&self.dir)).map(|()| evicted),
            None => Ok(evicted),
        }
    }

    /// Removes a tile; false when it is not there.
    fn remove(&self, id: TileId) -> Result<bool, Error> {
        let Some(name) = self.index().name(id) else { return Ok(false) };
        self.index().forget(name);
        files::remove(&name.path(&self.dir))?;
        Ok(true)
    }

    /// Removes the tiles that were not used for longest, but none that was used at `since` or later, until there is
    /// room for a tile of some bytes; returns how many.
    fn make_room(&self, newcomer: Option<(TileId, u64)>, since: u64) -> Result<u32, Error> {
        let max_bytes = self.limits.max_bytes;
        let mut evicted = 0;
        loop {
            let name = {
                let index = self.index();
                if index.bytes_with(newcomer) <= max_bytes {
                    return Ok(evicted);
                }
                index.oldest(since).ok_or_else(|| Error::Full { dir: self.dir.clone(), max_bytes })?
            };
            self.index().forget(name);
            files::remove(&name.path(&self.dir))?;
            evicted += 1;
        }
    }

    fn index(&self) -> MutexGuard<'_, CacheIndex> {
        // It stays right even if a holder panicked.
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a file of a form holds.
fn decode(form: Form, encoded: &[u8]) -> Result<Tile, DecodeError> {
    match form {
        Form::Tile => tile::decode(encoded),
        Form::Layer => tile::decode_layer(encoded),
    }
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> Error + '_ {
    move |source| Error::Io { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests;
