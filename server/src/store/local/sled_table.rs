//! A table of tiles in sled, in a directory of its own.

use uuid::Uuid;

use super::fuse::Fuse;
use super::room;
use super::sled_instance::Sled;
use super::table_dir::TableDir;
use crate::store::api::Error;
use crate::store::backend::tables::{Batch, Entries, TileTable};

/// Where the journal the tiles were folded from is named: apart from them.
const JOURNAL: &[u8] = b"journal";

/// An instance of sled. Once it refused a write nothing more is written to it.
pub(super) struct SledTable {
    /// After an error it must not be dropped as any value: see [`Sled::drop`].
    sled: Sled,
    fuse: Fuse,
    /// Declared last: goes when sled is closed.
    dir: TableDir,
}

impl SledTable {
    /// The table of a directory, made if there is none.
    pub(super) fn open(dir: TableDir, cache_bytes: u64) -> Result<Self, Error> {
        let sled = Sled::open(dir.path(), cache_bytes).inspect_err(|_| dir.forget_new())?;
        Ok(Self { sled, fuse: Fuse::default(), dir })
    }

    fn write(&self, work: impl FnOnce() -> Result<(), sled::Error>) -> Result<(), Error> {
        self.fuse.write(|| self.sled.watched(work)).inspect_err(|_| self.sled.give_up())
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
        self.write(|| {
            self.sled.db().insert(JOURNAL, &journal.as_bytes()[..])?;
            self.sled.db().flush().map(drop)
        })
    }

    fn broken(&self) -> Option<String> {
        self.fuse.broken()
    }

    fn room_for(&self, bytes: u64) -> Result<(), Error> {
        self.dir.parent().map_or(Ok(()), |parent| room::for_tiles(parent, bytes))
    }

    fn adopt(&self, journal: Uuid) -> Result<(), Error> {
        self.dir.adopt(journal)
    }

    fn retire(&self) {
        self.dir.retire();
    }
}
