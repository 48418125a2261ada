//! A generation of tiles: the map as folded under some controls.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::Duration;

use echofix_core::geo::TileId;
use echofix_core::tile;
use uuid::Uuid;

use super::attempt::{TilesError, caught};
use super::catalog::Catalog;
use super::checkpoint::Checkpoint;
use super::tiles::{TileStore, TileValue};
use super::write_buffer::{Folded, Source};
use crate::store::api::QuarantinedRecord;
use crate::store::api::{Error, io_error};
use crate::store::local::marker::{mark, marked};

/// Tiles written at once when many are.
const BATCH: usize = 64;
/// Attempts to remove a directory that sled's threads are just leaving.
const REMOVALS: usize = 100;

/// Tiles on disk and their catalog in memory.
pub(in crate::store) struct Generation {
    pub(in crate::store) number: u64,
    pub(in crate::store) tiles: TileStore,
    /// See [`crate::store::map::policy::Policy::publish_contributors`].
    publish: u8,
    catalog: RwLock<Catalog>,
    /// The last record it holds.
    folded: AtomicU64,
    /// Declared last: goes when sled is closed.
    dir: GenerationDir,
}

struct GenerationDir {
    path: PathBuf,
    retired: AtomicBool,
}

impl Drop for GenerationDir {
    fn drop(&mut self) {
        if !self.retired.load(Ordering::Acquire) {
            return;
        }
        // An instance of sled that failed keeps its file open: its room is given back all the same.
        if let Ok(file) = fs::OpenOptions::new().write(true).open(self.path.join("db")) {
            let _ = file.set_len(0);
        }
        for _ in 0..REMOVALS {
            match fs::remove_dir_all(&self.path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    std::thread::sleep(Duration::from_millis(10));
                }
                _ => return,
            }
        }
        tracing::warn!(path = %self.path.display(), "old tiles could not be removed; the next start does");
    }
}

impl Generation {
    /// A new, empty generation, marked as made from a journal; nothing may be in its place. It can be opened again once
    /// it is [complete](Self::complete).
    pub(in crate::store) fn create(
        path: &Path,
        number: u64,
        journal: Uuid,
        (cache_bytes, publish): (u64, u8),
    ) -> Result<Self, Error> {
        fs::create_dir(path)
            .and_then(|()| mark(path, journal))
            .map_err(io_error("making a directory for tiles"))?;
        let dir = GenerationDir::new(path);
        let tiles =
            TileStore::open(path, cache_bytes).inspect_err(|_| dir.retired.store(true, Ordering::Release))?;
        Ok(Self { number, tiles, publish, catalog: RwLock::default(), folded: AtomicU64::new(0), dir })
    }

    /// Names the journal that all of it was folded from. It is the last that is written of a new generation: one that a
    /// crash took back to the middle of its making is not taken for a whole one.
    pub(in crate::store) fn complete(&self, journal: Uuid) -> Result<(), Error> {
        self.tiles.set_journal(journal)
    }

    /// A generation as it was left; `Err` says why it cannot be used. sled
    /// panics on some damaged files: that is caught here.
    pub(in crate::store) fn open(
        path: &Path,
        number: u64,
        cache_bytes: u64,
        journal: Uuid,
        publish: u8,
    ) -> Result<Self, TilesError> {
        if !path.exists() {
            return Err(TilesError::Gone);
        }
        let (tiles, of) = caught(|| {
            let tiles = TileStore::open(path, cache_bytes)?;
            let of = tiles.journal()?;
            Ok((tiles, of))
        })?;
        if of != Some(journal) {
            return Err(TilesError::OtherJournal);
        }
        let (catalog, folded) = caught(|| Ok(tiles.check()))??;
        if marked(path).is_none() {
            // Of before there were markers.
            mark(path, journal).map_err(|error| TilesError::from(io_error("marking tiles")(error)))?;
        }
        let dir = GenerationDir::new(path);
        let (catalog, folded) = (RwLock::new(catalog), AtomicU64::new(folded));
        Ok(Self { number, tiles, publish, catalog, folded, dir })
    }

    /// Fills an empty generation from a checkpoint.
    pub(in crate::store) fn load(&self, checkpoint: &Checkpoint) -> Result<(), Error> {
        let mut batch = Vec::with_capacity(BATCH);
        checkpoint.visit(|id, version, encoded| {
            let damaged =
                |error| Error::Damaged { what: format!("tile {id} of the checkpoint"), reason: error };
            let tile = tile::decode(&encoded).map_err(|error| damaged(error.to_string()))?;
            batch.push((id, Folded { version, tile, ..Folded::default() }));
            if batch.len() == BATCH { self.put(batch.drain(..), &[], checkpoint.last) } else { Ok(()) }
        })?;
        self.put(batch.drain(..), &[], checkpoint.last)
    }

    /// Puts changed tiles in place, and the uploads that were quarantined; the generation goes up to
    /// the record `folded` with them.
    pub(in crate::store) fn put(
        &self,
        changed: impl Iterator<Item = (TileId, Folded)>,
        quarantined: &[QuarantinedRecord],
        folded: u64,
    ) -> Result<(), Error> {
        let values = changed.map(|(id, folded)| TileValue::new(id, &folded, self.publish)).collect();
        self.put_values(values, quarantined, folded)
    }

    fn put_values(
        &self,
        values: Vec<TileValue>,
        quarantined: &[QuarantinedRecord],
        folded: u64,
    ) -> Result<(), Error> {
        if let Some(parent) = self.dir.path.parent() {
            crate::store::local::room::for_tiles(parent, values.iter().map(TileValue::len).sum())?;
        }
        let infos: Vec<_> = values.iter().map(|value| value.info).collect();
        let digest = self.catalog().digest_with(&infos);
        self.tiles.put_all(values, quarantined, folded, digest)?;
        let mut catalog = self.catalog_mut();
        for info in infos {
            catalog.put(info);
        }
        self.folded.store(folded, Ordering::Release);
        Ok(())
    }

    /// The last record it holds.
    pub(in crate::store) fn folded(&self) -> u64 {
        self.folded.load(Ordering::Acquire)
    }

    /// Changes every tile.
    pub(super) fn change_all(
        &self,
        folded: u64,
        mut change: impl FnMut(TileId, &mut Folded) -> Result<bool, Error>,
    ) -> Result<(), Error> {
        for ids in self.ids().chunks(BATCH) {
            let mut changed = Vec::new();
            for id in ids {
                let mut tile = self.tiles.folded(*id)?;
                if change(*id, &mut tile)? {
                    changed.push((*id, tile));
                }
            }
            self.put(changed.into_iter(), &[], folded)?;
        }
        Ok(())
    }

    /// Fills an empty generation with the tiles of another one, as they are.
    pub(in crate::store) fn copy(&self, from: &Self) -> Result<(), Error> {
        let folded = from.folded();
        let quarantined = from.tiles.quarantined()?;
        self.put_values(Vec::new(), &quarantined, folded)?;
        for ids in from.ids().chunks(BATCH) {
            let lost = |id| Error::Damaged { what: format!("tile {id}"), reason: "it is gone".to_owned() };
            let copied = |id: &TileId| from.tiles.copied(*id)?.ok_or_else(|| lost(*id));
            self.put_values(ids.iter().map(copied).collect::<Result<_, _>>()?, &[], folded)?;
        }
        Ok(())
    }

    /// All tiles, in order.
    pub(in crate::store) fn ids(&self) -> Vec<TileId> {
        self.catalog().all().map(|info| info.id).collect()
    }

    /// Removes the directory once it has no readers any more.
    pub(super) fn retire(&self) {
        self.dir.retired.store(true, Ordering::Release);
    }

    pub(in crate::store) fn catalog(&self) -> RwLockReadGuard<'_, Catalog> {
        // A panic cannot leave the catalog half changed in a way that matters: it only counts.
        self.catalog.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn catalog_mut(&self) -> RwLockWriteGuard<'_, Catalog> {
        self.catalog.write().unwrap_or_else(PoisonError::into_inner)
    }
}

impl GenerationDir {
    fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), retired: AtomicBool::new(false) }
    }
}

impl Source for Generation {
    fn folded(&self, id: TileId) -> Result<Folded, Error> {
        self.tiles.folded(id)
    }
}

impl Source for &Generation {
    fn folded(&self, id: TileId) -> Result<Folded, Error> {
        self.tiles.folded(id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a generation in the making, which a power cut may leave behind, taken for a whole one.
    #[test]
    fn what_was_not_completed_is_not_opened() {
        let dir = tempfile::tempdir().unwrap();
        let (path, journal) = (dir.path().join("tiles-1"), Uuid::from_u128(5));
        let generation = Generation::create(&path, 1, journal, (1 << 20, 1)).unwrap();
        generation.load(&Checkpoint::default()).unwrap();
        drop(generation);
        assert!(Generation::open(&path, 1, 1 << 20, journal, 1).is_err());
        assert!(Generation::create(&path, 1, journal, (1 << 20, 1)).is_err(), "nothing is removed");
        fs::remove_dir_all(&path).unwrap();
        let generation = Generation::create(&path, 1, journal, (1 << 20, 1)).unwrap();
        generation.load(&Checkpoint::default()).unwrap();
        generation.complete(journal).unwrap();
        drop(generation);
        assert!(Generation::open(&path, 1, 1 << 20, journal, 1).is_ok());
    }
}
