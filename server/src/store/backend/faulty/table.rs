//! Faults around tables.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use uuid::Uuid;

use super::{Call, Fault, Faults, with};
use crate::store::api::Error;
use crate::store::backend::tables::{Batch, Entries, TableId, TableUse, TileTable, TileTables};

pub(super) struct FaultyTables {
    inner: Arc<dyn TileTables>,
    faults: Faults,
}

impl FaultyTables {
    pub(super) fn new(inner: Arc<dyn TileTables>, faults: Faults) -> Self {
        Self { inner, faults }
    }

    fn opened(&self, id: TableId, inner: Box<dyn TileTable>) -> Box<dyn TileTable> {
        let (faults, broken, torn) = (self.faults.clone(), OnceLock::new(), Mutex::default());
        Box::new(FaultyTable { used: id.used, inner, faults, broken, torn })
    }
}

impl TileTables for FaultyTables {
    fn create(&self, id: TableId, journal: Uuid) -> Result<Box<dyn TileTable>, Error> {
        let created = self.faults.call(Call::Create(id.used), || self.inner.create(id, journal))?;
        Ok(self.opened(id, created))
    }

    fn open(&self, id: TableId) -> Result<Option<Box<dyn TileTable>>, Error> {
        let opened = self.faults.call(Call::Open(id.used), || self.inner.open(id))?;
        Ok(opened.map(|table| self.opened(id, table)))
    }

    fn next_number(&self) -> Result<u64, Error> {
        self.faults.call(Call::NextNumber, || self.inner.next_number())
    }

    fn clean(&self, journal: Uuid, served: Option<u64>, replaced: bool) -> Result<(), Error> {
        self.faults.call(Call::Clean, || self.inner.clean(journal, served, replaced))
    }
}

struct FaultyTable {
    used: TableUse,
    inner: Box<dyn TileTable>,
    faults: Faults,
    /// Why nothing is written any more.
    broken: OnceLock<String>,
    /// What is seen of a batch that was torn, until the table is opened again.
    torn: Mutex<BTreeMap<Vec<u8>, Option<Vec<u8>>>>,
}

impl FaultyTable {
    fn write(&self, call: Call, work: impl FnOnce(Option<Fault>) -> Result<(), Error>) -> Result<(), Error> {
        if let Some(reason) = self.broken() {
            return Err(Error::Broken(reason));
        }
        work(self.faults.next(call)).inspect_err(|error| _ = self.broken.set(error.to_string()))
    }

    fn torn(&self) -> MutexGuard<'_, BTreeMap<Vec<u8>, Option<Vec<u8>>>> {
        self.torn.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl TileTable for FaultyTable {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, Error> {
        if let Some(torn) = self.torn().get(key) {
            return Ok(torn.clone());
        }
        self.faults.call(Call::Get(self.used), || self.inner.get(key))
    }

    fn scan<'a>(&'a self, from: &[u8]) -> Entries<'a> {
        if let Err(error) = self.faults.call(Call::Scan(self.used), || Ok::<_, Error>(())) {
            return Box::new(std::iter::once(Err(error)));
        }
        let torn: BTreeMap<_, _> =
            self.torn().range(from.to_vec()..).map(|(key, value)| (key.clone(), value.clone())).collect();
        if torn.is_empty() {
            return self.inner.scan(from);
        }
        let whole: Result<BTreeMap<_, _>, Error> =
            self.inner.scan(from).map(|entry| entry.map(|(key, value)| (key, Some(value)))).collect();
        match whole {
            Err(error) => Box::new(std::iter::once(Err(error))),
            Ok(mut seen) => {
                seen.extend(torn);
                Box::new(seen.into_iter().filter_map(|(key, value)| Some(Ok((key, value?)))))
            }
        }
    }

    fn apply(&self, batch: Batch) -> Result<(), Error> {
        self.write(Call::Apply(self.used), |fault| {
            if fault == Some(Fault::Torn) {
                let changes: Vec<_> = batch.clone().into_changes().collect();
                let half = changes.len().div_ceil(2);
                self.torn().extend(changes.into_iter().take(half));
            }
            with(fault, || self.inner.apply(batch))
        })
    }

    fn flush(&self) -> Result<(), Error> {
        self.write(Call::Flush(self.used), |fault| with(fault, || self.inner.flush()))
    }

    fn made_from(&self) -> Result<Option<Uuid>, Error> {
        self.faults.call(Call::Get(self.used), || self.inner.made_from())
    }

    fn complete(&self, journal: Uuid) -> Result<(), Error> {
        self.write(Call::Complete(self.used), |fault| with(fault, || self.inner.complete(journal)))
    }

    fn broken(&self) -> Option<String> {
        self.broken.get().cloned().or_else(|| self.inner.broken())
    }

    fn room_for(&self, bytes: u64) -> Result<(), Error> {
        self.inner.room_for(bytes)
    }

    fn adopt(&self, journal: Uuid) -> Result<(), Error> {
        self.inner.adopt(journal)
    }

    fn retire(&self) {
        self.inner.retire();
    }
}
