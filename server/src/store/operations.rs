//! What operators may do with the map.

use uuid::Uuid;

use super::Error;

/// Decisions about the map's history. Each is a record of the journal: synced when the call returns its
/// number. The map shows it from that epoch on, see [`super::MapStore::progress`]; until then it is served
/// as it was. Every call may block on the disk.
pub trait Operations: Send + Sync {
    /// Takes back all a contributor has told so far. What it sends from now on counts.
    ///
    /// # Errors
    /// When it told nothing that can be taken back, or the journal cannot be written.
    fn revoke_contributor(&self, pseudonym: &str) -> Result<u64, Error>;

    /// Takes back an upload, or all tiles of an imported file.
    ///
    /// # Errors
    /// When there is none of this id that can be taken back, or the journal cannot be written.
    fn revoke_upload(&self, id: Uuid) -> Result<u64, Error>;

    /// Takes back all uploads and imports after an epoch. Revocations stay.
    ///
    /// # Errors
    /// When the epoch is not in the journal, or the journal cannot be written.
    fn rollback(&self, epoch: u64) -> Result<u64, Error>;

    /// Makes final what was written before a UTC day, counted from the Unix epoch: it can no longer be
    /// taken back, and nothing remembers who told it. `None` when there is nothing to settle.
    ///
    /// # Errors
    /// When the journal cannot be written.
    fn settle(&self, before_day: u16) -> Result<Option<u64>, Error>;
}
