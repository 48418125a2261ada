//! Who contributed, and what.

use serde::Serialize;
use utoipa::ToSchema;

/// Contributors, by their keyed hashes.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Contributors)]
pub struct ContributorsAnswer {
    /// A part of those that were asked for, in the order that was asked for.
    pub contributors: Vec<ContributorAnswer>,
    /// How many there are in all of those that were asked for.
    pub found: usize,
}

/// What a contributor uploaded, of what is not compacted.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Contributor)]
pub struct ContributorAnswer {
    /// Keyed hash of the contributor's pseudonym, 16 hexadecimal digits. It can be revoked by it.
    #[schema(example = "00e1a7c0ffee1234")]
    pub contributor: String,
    /// Uploads in the journal.
    pub uploads: u64,
    /// How many of them decisions took back.
    pub taken_back: u64,
    /// How many of the others vetting keeps out of the map.
    pub quarantined: u64,
    /// UTC date of the first of them.
    #[schema(format = Date)]
    pub first_date: String,
    /// UTC date of the last of them.
    #[schema(format = Date)]
    pub last_date: String,
    /// Epoch of the last of them.
    pub last_epoch: u64,
    /// The newest revocation of the contributor that is in effect; null without one. What was uploaded later counts.
    #[schema(required)]
    pub revoked: Option<RevocationAnswer>,
}

/// A contributor's revocation.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Revocation)]
pub struct RevocationAnswer {
    /// Its epoch: the decision that `undo` takes.
    pub epoch: u64,
    /// When it was decided, microseconds since the Unix epoch.
    pub at_us: i64,
    /// Who decided, where that is known.
    #[schema(required)]
    pub by: Option<String>,
    /// Why, where it was said.
    #[schema(required)]
    pub reason: Option<String>,
}

/// Uploads of a contributor.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ContributorUploads)]
pub struct ContributorUploadsAnswer {
    /// The contributor's keyed hash.
    pub contributor: String,
    /// Newest first.
    pub uploads: Vec<ContributedUploadAnswer>,
    /// The epoch before which the next ones lie; absent with the last.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next_before: Option<u64>,
}

/// An upload, and who contributed it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = KnownUpload)]
pub struct KnownUploadAnswer {
    /// The contributor's keyed hash.
    pub contributor: String,
    /// The upload.
    #[serde(flatten)]
    pub upload: ContributedUploadAnswer,
}

/// An upload of a contributor.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ContributedUpload)]
pub struct ContributedUploadAnswer {
    /// Its epoch.
    pub epoch: u64,
    /// The id that the contributor chose; null when it was compacted just now.
    #[schema(required, format = "uuid")]
    pub upload_id: Option<String>,
    /// UTC date it came.
    #[schema(format = Date)]
    pub date: String,
    /// `COUNTED`, `QUARANTINED` or `TAKEN_BACK`.
    #[schema(pattern = "^(COUNTED|QUARANTINED|TAKEN_BACK)$", example = "COUNTED")]
    pub outcome: &'static str,
}
