//! Tables of tiles: keys and values, in the order of their keys, changed in batches.

use uuid::Uuid;

use crate::store::api::Error;

/// A key and its value.
pub(in crate::store) type Entry = (Vec<u8>, Vec<u8>);
/// Entries in the order of their keys.
pub(in crate::store) type Entries<'a> = Box<dyn Iterator<Item = Result<Entry, Error>> + 'a>;

/// Changes that are made all or none. Of one key the last one counts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(in crate::store) struct Batch(Vec<(Vec<u8>, Option<Vec<u8>>)>);

impl Batch {
    /// Puts a value in place of the one there is.
    pub(in crate::store) fn put(&mut self, key: &[u8], value: &[u8]) {
        self.0.push((key.to_vec(), Some(value.to_vec())));
    }

    /// Removes a key.
    pub(in crate::store) fn remove(&mut self, key: &[u8]) {
        self.0.push((key.to_vec(), None));
    }

    /// The changes: a value, or `None` for a key that goes.
    pub(in crate::store) fn into_changes(self) -> impl Iterator<Item = (Vec<u8>, Option<Vec<u8>>)> {
        self.0.into_iter()
    }
}

/// One table. Dropping it closes it, and never waits for ever, whatever failed before.
pub(in crate::store) trait TileTable: Send + Sync {
    /// The value of a key.
    ///
    /// # Errors
    /// When the backend refuses.
    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, Error>;

    /// All entries from a key on. Changes that are made meanwhile may be seen or not.
    fn scan<'a>(&'a self, from: &[u8]) -> Entries<'a>;

    /// Makes the changes of a batch, durably. After a failure any part of them may be seen, and the table is
    /// [broken](Self::broken); once it is opened again all of them are there, or none.
    ///
    /// # Errors
    /// When the backend refuses or refused before.
    fn apply(&self, batch: Batch) -> Result<(), Error>;

    /// Makes all durable that was written.
    ///
    /// # Errors
    /// When the backend refuses or refused before.
    fn flush(&self) -> Result<(), Error>;

    /// The journal that all of it was folded from; `None` where nothing says so yet.
    ///
    /// # Errors
    /// When the backend refuses.
    fn made_from(&self) -> Result<Option<Uuid>, Error>;

    /// Says which journal all of it was folded from, durably.
    ///
    /// # Errors
    /// When the backend refuses or refused before.
    fn complete(&self, journal: Uuid) -> Result<(), Error>;

    /// Why nothing is written any more; `None` while all is well.
    fn broken(&self) -> Option<String>;

    /// Is there room for a batch of so many bytes?
    ///
    /// # Errors
    /// [`Error::NoRoom`] when there is not; or when that cannot be told.
    fn room_for(&self, bytes: u64) -> Result<(), Error>;

    /// What it was made from is believed: from now on it is the store's to remove.
    ///
    /// # Errors
    /// When the backend refuses.
    fn adopt(&self, journal: Uuid) -> Result<(), Error>;

    /// Removes its data once it is dropped.
    fn retire(&self);
}

/// What a table is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(in crate::store) enum TableUse {
    /// A generation of tiles, to be served.
    Served,
    /// Tiles that are folded to be compacted.
    Scratch,
}

/// The name of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(in crate::store) struct TableId {
    /// What it is for.
    pub(in crate::store) used: TableUse,
    /// No two tables have the same.
    pub(in crate::store) number: u64,
}

/// The tables of one store.
pub(in crate::store) trait TileTables: Send + Sync {
    /// A new, empty table, marked as made from a journal.
    ///
    /// # Errors
    /// When something has its name, which stays as it is; or when the backend refuses.
    fn create(&self, id: TableId, journal: Uuid) -> Result<Box<dyn TileTable>, Error>;

    /// A table as it was left; `None` where there is none.
    ///
    /// # Errors
    /// When it cannot be opened.
    fn open(&self, id: TableId) -> Result<Option<Box<dyn TileTable>>, Error>;

    /// A number that is free: nothing has a name with it, whoever made that.
    ///
    /// # Errors
    /// When the backend refuses.
    fn next_number(&self) -> Result<u64, Error>;

    /// Removes tables that this store made and no longer needs, and what it did not finish. `replaced` says that the
    /// manifest is sound: then other tables of its journal are older ones, or unfinished. Without it they may hold what the
    /// journal lost, and are set aside.
    ///
    /// # Errors
    /// When the backend refuses.
    fn clean(&self, journal: Uuid, served: Option<u64>, replaced: bool) -> Result<(), Error>;
}
