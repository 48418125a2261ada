//! Tables in memory.

use std::collections::BTreeMap;
use std::ops::Bound;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use uuid::Uuid;

use super::locked;
use crate::store::api::Error;
use crate::store::backend::tables::{Batch, Entries, Entry, TableId, TableUse, TileTable, TileTables};

#[derive(Default)]
pub(super) struct Tables(Mutex<BTreeMap<TableId, Arc<Table>>>);

/// What a table holds.
struct Table {
    marked: Uuid,
    entries: Mutex<BTreeMap<Vec<u8>, Vec<u8>>>,
    made_from: Mutex<Option<Uuid>>,
    /// What is left of that after a power cut.
    durably_made_from: Mutex<Option<Uuid>>,
}

impl Tables {
    pub(super) fn cut_power(&self) {
        for table in locked(&self.0).values() {
            *locked(&table.made_from) = *locked(&table.durably_made_from);
        }
    }
}

pub(super) struct MemoryTables(pub(super) Arc<Tables>);

impl TileTables for MemoryTables {
    fn create(&self, id: TableId, journal: Uuid) -> Result<Box<dyn TileTable>, Error> {
        let mut all = locked(&self.0.0);
        if all.contains_key(&id) {
            return Err(Error::Unusable(format!("there is a table {id:?}")));
        }
        let table = Arc::new(Table {
            marked: journal,
            entries: Mutex::default(),
            made_from: Mutex::default(),
            durably_made_from: Mutex::default(),
        });
        all.insert(id, table.clone());
        Ok(Box::new(OpenTable { all: self.0.clone(), id, table, retired: AtomicBool::new(false) }))
    }

    fn open(&self, id: TableId) -> Result<Option<Box<dyn TileTable>>, Error> {
        let Some(table) = locked(&self.0.0).get(&id).cloned() else { return Ok(None) };
        let retired = AtomicBool::new(false);
        Ok(Some(Box::new(OpenTable { all: self.0.clone(), id, table, retired })))
    }

    fn next_number(&self) -> Result<u64, Error> {
        Ok(locked(&self.0.0).keys().map(|id| id.number).max().unwrap_or(0) + 1)
    }

    fn clean(&self, journal: Uuid, served: Option<u64>, replaced: bool) -> Result<(), Error> {
        let served = served.map(|number| TableId { used: TableUse::Served, number });
        // Here nobody looks at what is set aside.
        let ours = |id: &TableId, table: &Table| {
            table.marked == journal && (id.used == TableUse::Scratch || replaced)
        };
        locked(&self.0.0).retain(|id, table| Some(*id) == served || !ours(id, table));
        Ok(())
    }
}

struct OpenTable {
    all: Arc<Tables>,
    id: TableId,
    table: Arc<Table>,
    retired: AtomicBool,
}

impl Drop for OpenTable {
    fn drop(&mut self) {
        if self.retired.load(Ordering::Acquire) {
            locked(&self.all.0).remove(&self.id);
        }
    }
}

impl TileTable for OpenTable {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, Error> {
        Ok(locked(&self.table.entries).get(key).cloned())
    }

    fn scan<'a>(&'a self, from: &[u8]) -> Entries<'a> {
        let mut next = Bound::Included(from.to_vec());
        Box::new(std::iter::from_fn(move || {
            let entries = locked(&self.table.entries);
            let (key, value) = entries.range((next.clone(), Bound::Unbounded)).next()?;
            next = Bound::Excluded(key.clone());
            Some(Ok::<Entry, Error>((key.clone(), value.clone())))
        }))
    }

    fn apply(&self, batch: Batch) -> Result<(), Error> {
        let mut entries = locked(&self.table.entries);
        for (key, value) in batch.into_changes() {
            match value {
                Some(value) => entries.insert(key, value),
                None => entries.remove(&key),
            };
        }
        drop(entries);
        self.flush()
    }

    fn flush(&self) -> Result<(), Error> {
        *locked(&self.table.durably_made_from) = *locked(&self.table.made_from);
        Ok(())
    }

    fn made_from(&self) -> Result<Option<Uuid>, Error> {
        Ok(*locked(&self.table.made_from))
    }

    fn complete(&self, journal: Uuid) -> Result<(), Error> {
        *locked(&self.table.made_from) = Some(journal);
        Ok(())
    }

    fn broken(&self) -> Option<String> {
        None
    }

    fn room_for(&self, _: u64) -> Result<(), Error> {
        Ok(())
    }

    fn adopt(&self, _: Uuid) -> Result<(), Error> {
        Ok(())
    }

    fn retire(&self) {
        self.retired.store(true, Ordering::Release);
    }
}
