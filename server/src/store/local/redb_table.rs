//! A table of tiles in redb, in a directory of its own.

use std::path::Path;

use redb::{Database, ReadableDatabase, TableDefinition};
use uuid::Uuid;

use super::fuse::Fuse;
use super::room;
use super::table_dir::TableDir;
use crate::store::api::Error;
use crate::store::backend::tables::{Batch, Entries, Entry, TileTable};

const TILES: TableDefinition<'_, &[u8], &[u8]> = TableDefinition::new("tiles");
/// Where the journal the tiles were folded from is named: apart from them.
const ORIGIN: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("origin");
const JOURNAL: &str = "journal";
const FILE: &str = "tiles.redb";

/// A database of redb, each of whose batches is a transaction.
pub(super) struct RedbTable {
    database: Database,
    fuse: Fuse,
    /// Declared last: goes when the database is closed.
    dir: TableDir,
}

impl RedbTable {
    /// The table of a directory, made if there is none.
    pub(super) fn open(dir: TableDir, cache_bytes: u64) -> Result<Self, Error> {
        let database = opened(dir.path(), cache_bytes).inspect_err(|_| dir.forget_new())?;
        Ok(Self { database, fuse: Fuse::default(), dir })
    }

    fn entries(
        &self,
        from: &[u8],
    ) -> Result<redb::Range<'static, &'static [u8], &'static [u8]>, redb::Error> {
        Ok(self.database.begin_read()?.open_table(TILES)?.range(from..)?)
    }
}

fn opened(dir: &Path, cache_bytes: u64) -> Result<Database, Error> {
    let open = || {
        let cache = usize::try_from(cache_bytes).unwrap_or(usize::MAX);
        let database = Database::builder().set_cache_size(cache).create(dir.join(FILE))?;
        let both = database.begin_write()?;
        both.open_table(TILES)?;
        both.open_table(ORIGIN)?;
        both.commit()?;
        Ok(database)
    };
    open().map_err(failed)
}

fn failed(error: redb::Error) -> Error {
    match error {
        redb::Error::Corrupted(reason) => Error::Damaged { what: "the table of tiles".to_owned(), reason },
        redb::Error::Io(source) => Error::Tiles { reason: source.to_string(), io: Some(source.kind()) },
        other => Error::Tiles { reason: other.to_string(), io: None },
    }
}

type Guarded<'a> = redb::AccessGuard<'a, &'static [u8]>;

fn owned((key, value): (Guarded<'_>, Guarded<'_>)) -> Entry {
    (key.value().to_vec(), value.value().to_vec())
}

impl TileTable for RedbTable {
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, Error> {
        let get = || {
            let value = self.database.begin_read()?.open_table(TILES)?.get(key)?;
            Ok(value.map(|value| value.value().to_vec()))
        };
        get().map_err(failed)
    }

    fn scan<'a>(&'a self, from: &[u8]) -> Entries<'a> {
        match self.entries(from) {
            Ok(entries) => {
                Box::new(entries.map(|entry| entry.map(owned).map_err(|error| failed(error.into()))))
            }
            Err(error) => Box::new(std::iter::once(Err(failed(error)))),
        }
    }

    fn apply(&self, batch: Batch) -> Result<(), Error> {
        let apply = || {
            let transaction = self.database.begin_write()?;
            {
                let mut tiles = transaction.open_table(TILES)?;
                for (key, value) in batch.into_changes() {
                    match value {
                        Some(value) => tiles.insert(&key[..], &value[..])?,
                        None => tiles.remove(&key[..])?,
                    };
                }
            }
            Ok(transaction.commit()?)
        };
        self.fuse.write(|| apply().map_err(|error: redb::Error| Error::Broken(failed(error).to_string())))
    }

    fn flush(&self) -> Result<(), Error> {
        // Every transaction is durable.
        self.fuse.write(|| Ok(()))
    }

    fn made_from(&self) -> Result<Option<Uuid>, Error> {
        let get = || {
            let journal = self.database.begin_read()?.open_table(ORIGIN)?.get(JOURNAL)?;
            Ok(journal.map(|journal| Uuid::from_slice(journal.value()).unwrap_or_default()))
        };
        get().map_err(failed)
    }

    fn complete(&self, journal: Uuid) -> Result<(), Error> {
        let put = || {
            let transaction = self.database.begin_write()?;
            transaction.open_table(ORIGIN)?.insert(JOURNAL, &journal.as_bytes()[..])?;
            Ok(transaction.commit()?)
        };
        self.fuse.write(|| put().map_err(failed))
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
