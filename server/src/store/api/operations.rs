//! What operators may do with the map.

use std::io::{Read, Write};

use tokio::sync::broadcast;
use uuid::Uuid;

use super::{Error, HistoryEvent, Imported, QuarantinedRecord, Region, Snapshot, TileDiff, Verified};

/// Decisions about the map's history. Each is a record of the journal: synced when the call returns its
/// number. The map shows it from that epoch on, see [`super::MapStore::progress`]; until then it is served
/// as it was. Every call may block on the disk.
pub trait Operations: Send + Sync {
    /// Takes back all that a contributor has uploaded so far. What it uploads from now on counts.
    ///
    /// # Errors
    /// When it uploaded nothing that can be taken back, or the journal cannot be written.
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

    /// Compacts what was written before a UTC day, counted from the Unix epoch: it can no longer be
    /// taken back, and nothing remembers who contributed it. `None` when there is nothing to compact.
    ///
    /// # Errors
    /// When the journal cannot be written.
    fn compact(&self, before_day: u16) -> Result<Option<u64>, Error>;

    /// The uploads that vetting kept out of the map, oldest first; those that were compacted are forgotten.
    ///
    /// # Errors
    /// When the map is being rebuilt, or the disk refuses.
    fn quarantined(&self) -> Result<Vec<QuarantinedRecord>, Error>;

    /// Follows what vetting keeps out of the map from now on; a slow listener misses some.
    fn kept_out(&self) -> broadcast::Receiver<QuarantinedRecord>;

    /// What happened to the map, newest first: uploads by runs, controls one by one. What was compacted is
    /// not listed any more.
    fn history(&self, limit: usize) -> Vec<HistoryEvent>;

    /// The map as of an epoch, folded from the journal into memory.
    ///
    /// # Errors
    /// When the epoch is before what was compacted, or after the newest, or the disk refuses.
    fn at(&self, epoch: u64) -> Result<Snapshot, Error>;

    /// How the map of epoch `to` differs from that of `from`.
    ///
    /// # Errors
    /// As [`Operations::at`].
    fn diff(&self, from: u64, to: u64) -> Result<Vec<TileDiff>, Error> {
        Ok(self.at(from)?.diff(&self.at(to)?))
    }

    /// Writes a region's map as one checksummed file; returns how many tiles are in it. It holds at least
    /// what the map of its epoch does.
    ///
    /// # Errors
    /// When the map is being rebuilt, the disk refuses, or `out` does.
    fn export(&self, region: &Region, out: &mut dyn Write) -> Result<u64, Error>;

    /// Adds what [`Operations::export`] wrote to the map, through the journal. Each of its tiles counts once,
    /// by the file's id: an import that was cut short is completed by doing it again.
    ///
    /// # Errors
    /// When the file is not whole and sound, nothing of it counts then; or the journal cannot be written.
    fn import(&self, file: &mut dyn Read) -> Result<Imported, Error>;

    /// Writes a backup: a consistent copy of the store as a tar archive, made while it is in use; returns the bytes of its
    /// files. It holds the key that contributors are hashed with: keep it as secret as the store itself.
    ///
    /// # Errors
    /// When the disk refuses, or `out` does.
    fn backup(&self, out: &mut dyn Write) -> Result<u64, Error>;

    /// Reads all of the journal, the checkpoint and the tiles; with `replay`, also folds the journal again and
    /// compares.
    ///
    /// # Errors
    /// When the map is being rebuilt. Damage is an answer, not an error.
    fn verify(&self, replay: bool) -> Result<Verified, Error>;
}
