//! Who contributed, by keyed hashes of their pseudonyms.

use uuid::Uuid;

use super::Remark;

/// What a contributor uploaded, of what is not compacted: nothing remembers who contributed the rest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ContributorFigures {
    /// Keyed hash of the contributor's pseudonym.
    pub hash: u64,
    /// Uploads in the journal.
    pub uploads: u64,
    /// How many of them decisions took back.
    pub taken_back: u64,
    /// How many of the others vetting keeps out of the map.
    pub quarantined: u64,
    /// UTC day of the first of them, counted from the Unix epoch.
    pub first_day: u16,
    /// UTC day of the last of them.
    pub last_day: u16,
    /// Number of the last of them.
    pub last: u64,
    /// The newest revocation of the contributor that is in effect; what came after it counts.
    pub revoked: Option<Revocation>,
}

/// A contributor's revocation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Revocation {
    /// Number of its record.
    pub number: u64,
    /// Time of the decision, microseconds since the Unix epoch.
    pub at_us: i64,
    /// Who decided, and why.
    pub remark: Remark,
}

/// One upload of a contributor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ContributedUpload {
    /// Number of its record.
    pub number: u64,
    /// The id that the contributor chose; `None` when it was compacted meanwhile.
    pub id: Option<Uuid>,
    /// UTC day it was written on, counted from the Unix epoch.
    pub day: u16,
    /// What became of it.
    pub fate: UploadFate,
}

/// What became of an upload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UploadFate {
    /// It counts.
    Counted,
    /// Vetting keeps it out of the map.
    Quarantined,
    /// A decision took it back.
    TakenBack,
}
