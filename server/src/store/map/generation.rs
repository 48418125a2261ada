//! A generation of tiles: the map as folded under some controls.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use echofix_core::geo::TileId;
use echofix_core::tile;
use uuid::Uuid;

use super::attempt::{TilesError, caught};
use super::catalog::Catalog;
use super::checkpoint::Checkpoint;
use super::tiles::{TileStore, TileValue};
use super::write_buffer::{Folded, Source};
use crate::store::api::{Error, QuarantinedRecord};
use crate::store::backend::objects::Objects;
use crate::store::backend::tables::{TableId, TableUse, TileTables};
use crate::store::log::index::JournalIndex;

/// Tiles written at once when many are.
const BATCH: usize = 64;

/// Tiles on disk and their catalog in memory.
pub(in crate::store) struct Generation {
    pub(in crate::store) number: u64,
    pub(in crate::store) tiles: TileStore,
    /// See [`crate::store::map::policy::Policy::publish_contributors`].
    publish: u8,
    catalog: RwLock<Catalog>,
    /// The last record it holds.
    folded: AtomicU64,
}

impl Generation {
    /// A new, empty generation, marked as made from a journal; nothing may be in its place. It can be opened again once
    /// it is [complete](Self::complete).
    pub(in crate::store) fn create(
        tables: &dyn TileTables,
        id: TableId,
        journal: Uuid,
        publish: u8,
    ) -> Result<Self, Error> {
        let tiles = TileStore::of(tables.create(id, journal)?);
        let (catalog, folded) = (RwLock::default(), AtomicU64::new(0));
        Ok(Self { number: id.number, tiles, publish, catalog, folded })
    }

    /// Names the journal that all of it was folded from. It is the last that is written of a new generation: one that a
    /// crash took back to the middle of its making is not taken for a whole one.
    pub(in crate::store) fn complete(&self, journal: Uuid) -> Result<(), Error> {
        self.tiles.table().complete(journal)
    }

    /// A generation as it was left; `Err` says why it cannot be used. A table may
    /// panic on damaged files: that is caught here.
    pub(in crate::store) fn open(
        tables: &dyn TileTables,
        number: u64,
        journal: Uuid,
        publish: u8,
    ) -> Result<Self, TilesError> {
        let id = TableId { used: TableUse::Served, number };
        let found = caught(|| match tables.open(id)? {
            Some(table) => Ok(Some((table.made_from()?, table))),
            None => Ok(None),
        })?;
        let (of, table) = found.ok_or(TilesError::Gone)?;
        if of != Some(journal) {
            return Err(TilesError::OtherJournal);
        }
        let tiles = TileStore::of(table);
        let (catalog, folded) = caught(|| Ok(tiles.check()))??;
        tiles.table().adopt(journal)?;
        let (catalog, folded) = (RwLock::new(catalog), AtomicU64::new(folded));
        Ok(Self { number, tiles, publish, catalog, folded })
    }

    /// Fills an empty generation from a checkpoint.
    pub(in crate::store) fn load(&self, objects: &dyn Objects, checkpoint: &Checkpoint) -> Result<(), Error> {
        let mut batch = Vec::with_capacity(BATCH);
        checkpoint.visit(objects, |id, version, encoded| {
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

    /// The same, in the bytes they are stored in.
    pub(super) fn put_values(
        &self,
        values: Vec<TileValue>,
        quarantined: &[QuarantinedRecord],
        folded: u64,
    ) -> Result<(), Error> {
        self.tiles.table().room_for(values.iter().map(TileValue::len).sum())?;
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

    /// Does it hold all that it was made under?
    ///
    /// # Errors
    /// When it holds more than the journal.
    pub(in crate::store) fn is_whole(&self, applied: u64, index: &JournalIndex) -> Result<bool, Error> {
        let folded = self.folded();
        if folded > index.newest() {
            return Err(journal_is_short(folded, index.newest()));
        }
        let whole = folded >= applied.max(index.before());
        if !whole {
            tracing::warn!(folded, applied, "the tiles are not whole; folding them anew");
        }
        Ok(whole)
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

    /// Removes its tiles once it has no readers any more.
    pub(in crate::store) fn retire(&self) {
        self.tiles.table().retire();
    }

    pub(in crate::store) fn catalog(&self) -> RwLockReadGuard<'_, Catalog> {
        // A panic cannot leave the catalog half changed in a way that matters: it only counts.
        self.catalog.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn catalog_mut(&self) -> RwLockWriteGuard<'_, Catalog> {
        self.catalog.write().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Tiles are folded from records on disk only, so the journal has lost some.
fn journal_is_short(folded: u64, end: u64) -> Error {
    Error::Damaged {
        what: "the journal".to_owned(),
        reason: format!(
            "it ends at record {end} but the tiles hold record {folded}: acknowledged uploads are missing. \
             Restore the journal, or delete the manifest to go on without them"
        ),
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
    use crate::store::backend::Backend;
    use crate::store::backend::memory::Memory;

    /// Catches: a generation in the making, which a power cut may leave behind, taken for a whole one.
    #[test]
    fn what_was_not_completed_is_not_opened() {
        let journal = Uuid::from_u128(5);
        let Backend { tables, objects, .. } = Memory::default().open();
        let create = |number| {
            let id = TableId { used: TableUse::Served, number };
            let generation = Generation::create(&*tables, id, journal, 1)?;
            generation.load(&*objects, &Checkpoint::default()).map(|()| generation)
        };
        drop(create(1).unwrap());
        assert!(matches!(Generation::open(&*tables, 1, journal, 1), Err(TilesError::OtherJournal)));
        assert!(create(1).is_err(), "nothing is removed");
        create(2).unwrap().complete(journal).unwrap();
        assert!(Generation::open(&*tables, 2, journal, 1).is_ok());
    }
}
