//! What operators decide about the map's history, before and after it is decided.

use uuid::Uuid;

use super::TileDiff;

/// Longest reason and longest name of a remark, bytes.
pub const LONGEST_REMARK: usize = 500;

/// Whose uploads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Contributor {
    /// The name under which it uploads, which is not stored.
    Pseudonym(String),
    /// The keyed hash of that name, as quarantine and history tell it.
    Hash(u64),
}

/// What an operator wants decided.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Proposal {
    /// To take back all that a contributor has uploaded so far. What it uploads from then on counts.
    RevokeContributor(Contributor),
    /// To take back an upload, or all tiles of an imported file.
    RevokeUpload(Uuid),
    /// To take back all uploads and imports after an epoch. Revocations stay.
    Rollback(u64),
    /// To undo the rollback, the revocation or the undoing that is the record of this number: what it took back counts
    /// again.
    Undo(u64),
    /// To compact what was written before a UTC day, counted from the Unix epoch: it can no longer be taken back, and
    /// nothing remembers who contributed it.
    Compact(u16),
}

/// Who decided, and why, in words. Either may be absent; both are stored in the journal.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Remark {
    /// Who decided, where the service knows it.
    pub by: Option<String>,
    /// Why, where it was said.
    pub reason: Option<String>,
}

impl Remark {
    /// Nothing is said.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.by.is_none() && self.reason.is_none()
    }
}

/// What an operator has decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// To take back the uploads of the contributor of this keyed hash. Its name is not stored.
    RevokeContributor(u64),
    /// To take back an upload or an imported file.
    RevokeUpload(Uuid),
    /// To take back all after this epoch.
    Rollback(u64),
    /// To undo the decision that is this record.
    Undo(u64),
    /// To compact all up to this record.
    Compact(u64),
}

/// What a proposal would change.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Preview {
    /// Uploads that would no longer count.
    pub uploads_out: u64,
    /// Uploads that would count again.
    pub uploads_back: u64,
    /// Imported tiles that would no longer count.
    pub imports_out: u64,
    /// Imported tiles that would count again.
    pub imports_back: u64,
    /// Distinct contributors of those uploads.
    pub contributors: u64,
    /// Uploads that nobody could take back any more, nor bring back.
    pub compacted: u64,
    /// How the map would differ, tile by tile.
    pub tiles: Vec<TileDiff>,
}
