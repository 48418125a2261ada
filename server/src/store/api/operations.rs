//! What operators may do with the map.

use std::collections::{BTreeSet, HashMap};
use std::io::{Read, Write};
use std::sync::Arc;

use tokio::sync::broadcast;
use uuid::Uuid;

use super::{
    ContributedUpload, Contributor, ContributorFigures, Error, FoldingFigures, HistoryEvent, Imported,
    MapStore, Preview, Proposal, QuarantinedRecord, Region, Remark, Snapshot, TileDiff, Verified,
};

/// Decisions about the map's history. Each is a record of the journal: synced when the call returns its
/// number. The map shows it from that epoch on, see [`super::MapStore::progress`]; until then it is served
/// as it was. Every call may block on the disk.
pub trait Operations: Send + Sync {
    /// Writes a decision into the journal; `None` when there is nothing to compact.
    ///
    /// # Errors
    /// When there is nothing that it could take back or undo, what it names is compacted, or the journal cannot be written.
    fn decide(&self, proposal: &Proposal, remark: &Remark) -> Result<Option<u64>, Error>;

    /// What a decision would change. Nothing is written; the journal is folded in memory, twice.
    ///
    /// # Errors
    /// As [`Operations::decide`], or when the disk refuses.
    fn preview(&self, proposal: &Proposal) -> Result<Preview, Error>;

    /// The uploads that vetting kept out of the map, oldest first; those that were compacted are forgotten.
    ///
    /// # Errors
    /// When the map is being rebuilt, or the disk refuses.
    fn quarantined(&self) -> Result<Vec<QuarantinedRecord>, Error>;

    /// What folding has done since the service started.
    fn folding(&self) -> FoldingFigures {
        FoldingFigures::default()
    }

    /// The ids of the uploads that are these records, as far as the journal still has them.
    fn upload_ids(&self, numbers: &BTreeSet<u64>) -> HashMap<u64, Uuid>;

    /// Who contributed, in order of the hashes; those whose uploads are all compacted are forgotten.
    ///
    /// # Errors
    /// When the map is being rebuilt, or the disk refuses.
    fn contributors(&self) -> Result<Vec<ContributorFigures>, Error>;

    /// The newest uploads of a contributor with numbers before this one, at most `limit`, newest first.
    ///
    /// # Errors
    /// As [`Operations::contributors`].
    fn uploads_of(&self, hash: u64, before: u64, limit: usize) -> Result<Vec<ContributedUpload>, Error>;

    /// An upload in the journal by its id, and the keyed hash of its contributor.
    ///
    /// # Errors
    /// As [`Operations::contributors`].
    fn upload(&self, id: Uuid) -> Result<Option<(u64, ContributedUpload)>, Error>;

    /// Follows what vetting keeps out of the map from now on; a slow listener misses some.
    fn kept_out(&self) -> broadcast::Receiver<QuarantinedRecord>;

    /// What happened to the map, newest first: uploads by runs, controls one by one. What was compacted is
    /// not listed any more.
    fn history(&self, limit: usize) -> Vec<HistoryEvent>;

    /// The oldest and the newest epoch that a map can be had of.
    fn epochs(&self) -> (u64, u64);

    /// The map as it was served at an epoch, folded from the journal into memory: published cells, decayed to its newest day.
    ///
    /// # Errors
    /// As [`Operations::at`].
    fn served_at(&self, epoch: u64) -> Result<Arc<dyn MapStore>, Error>;

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

    /// Ends what goes on behind the calls: folding, and looks at the past. What is journaled and not folded is folded at the next
    /// start; uploads are still journaled, and the map is still read. Does not wait.
    fn wind_down(&self);

    /// Takes back all that a contributor has uploaded so far, by its pseudonym.
    ///
    /// # Errors
    /// As [`Operations::decide`].
    fn revoke_contributor(&self, pseudonym: &str) -> Result<u64, Error> {
        let contributor = Contributor::Pseudonym(pseudonym.to_owned());
        self.decide(&Proposal::RevokeContributor(contributor), &Remark::default()).map(written)
    }

    /// Takes back an upload, or all tiles of an imported file.
    ///
    /// # Errors
    /// As [`Operations::decide`].
    fn revoke_upload(&self, id: Uuid) -> Result<u64, Error> {
        self.decide(&Proposal::RevokeUpload(id), &Remark::default()).map(written)
    }

    /// Takes back all uploads and imports after an epoch.
    ///
    /// # Errors
    /// As [`Operations::decide`].
    fn rollback(&self, epoch: u64) -> Result<u64, Error> {
        self.decide(&Proposal::Rollback(epoch), &Remark::default()).map(written)
    }

    /// Compacts what was written before a UTC day, counted from the Unix epoch; `None` when there is nothing to compact.
    ///
    /// # Errors
    /// As [`Operations::decide`].
    fn compact(&self, before_day: u16) -> Result<Option<u64>, Error> {
        self.decide(&Proposal::Compact(before_day), &Remark::default())
    }
}

/// Only a compaction may have nothing to write.
fn written(number: Option<u64>) -> u64 {
    number.unwrap_or_default()
}
