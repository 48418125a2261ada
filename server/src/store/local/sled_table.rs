//! A table of tiles in sled, in a directory of its own.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::OnceLock;

use uuid::Uuid;

use super::marker::{mark, marked};
use super::room;
use super::sled_instance::Sled;
use super::table_dir::TableDir;
use crate::store::api::{Error, io_error};
use crate::store::backend::tables::{Batch, Entries, TileTable};

/// Where the journal the tiles were folded from is named: apart from them.
const JOURNAL: &[u8] = b"journal";

/// An instance of sled. Once it refused a write nothing more is written to it.
pub(super) struct SledTable {
    /// After an error it must not be dropped as any value: see [`Sled::drop`].
    sled: Sled,
    /// Why nothing is written any more.
    broken: OnceLock<String>,
    /// Declared last: goes when sled is closed.
    dir: TableDir,
}

impl SledTable {
    /// A table in a directory that was just made: it goes again where this fails.
    pub(in crate::store) fn create(path: &Path, cache_bytes: u64) -> Result<Self, Error> {
        let dir = TableDir::of(path);
        let sled = Sled::open(path, cache_bytes).inspect_err(|_| dir.retire())?;
        Ok(Self { sled, broken: OnceLock::new(), dir })
    }

    /// A table as it was left.
    pub(in crate::store) fn open(path: &Path, cache_bytes: u64) -> Result<Self, Error> {
        let sled = Sled::open(path, cache_bytes)?;
        Ok(Self { sled, broken: OnceLock::new(), dir: TableDir::of(path) })
    }

    /// Writes, unless an earlier write failed. sled panics on some damaged files.
    fn write(&self, work: impl FnOnce() -> Result<(), sled::Error>) -> Result<(), Error> {
        if let Some(reason) = self.broken() {
            return Err(Error::Broken(reason));
        }
        let failure = match catch_unwind(AssertUnwindSafe(work)) {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(error)) => Error::from(error),
            Err(_) => Error::Broken("it panicked".to_owned()),
        };
        let _ = self.broken.set(failure.to_string());
        self.sled.give_up();
        Err(failure)
    }
}

impl TileTable for SledTable {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, Error> {
        Ok(self.sled.tree().get(key)?.map(|value| value.to_vec()))
    }

    fn scan<'a>(&'a self, from: &[u8]) -> Entries<'a> {
        Box::new(self.sled.tree().range(from.to_vec()..).map(|entry| {
            let (key, value) = entry?;
            Ok((key.to_vec(), value.to_vec()))
        }))
    }

    fn apply(&self, batch: Batch) -> Result<(), Error> {
        let mut changes = sled::Batch::default();
        for (key, value) in batch.into_changes() {
            match value {
                Some(value) => changes.insert(key, value),
                None => changes.remove(key),
            }
        }
        let applied = self.write(|| {
            self.sled.tree().apply_batch(changes)?;
            self.sled.db().flush().map(drop)
        });
        applied.map_err(|error| match error {
            Error::Broken(reason) => Error::Broken(reason),
            other => Error::Broken(other.to_string()),
        })
    }

    fn flush(&self) -> Result<(), Error> {
        self.write(|| self.sled.db().flush().map(drop))
    }

    fn made_from(&self) -> Result<Option<Uuid>, Error> {
        Ok(self.sled.db().get(JOURNAL)?.map(|bytes| Uuid::from_slice(&bytes).unwrap_or_default()))
    }

    fn complete(&self, journal: Uuid) -> Result<(), Error> {
        self.write(|| self.sled.db().insert(JOURNAL, &journal.as_bytes()[..]).map(drop))
    }

    fn broken(&self) -> Option<String> {
        self.broken.get().cloned()
    }

    fn room_for(&self, bytes: u64) -> Result<(), Error> {
        self.dir.parent().map_or(Ok(()), |parent| room::for_tiles(parent, bytes))
    }

    fn adopt(&self, journal: Uuid) -> Result<(), Error> {
        // Of before there were markers.
        match marked(self.dir.path()) {
            Some(_) => Ok(()),
            None => mark(self.dir.path(), journal).map_err(io_error("marking tiles")),
        }
    }

    fn retire(&self) {
        self.dir.retire();
    }
}
