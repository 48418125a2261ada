//! What happened to the map, how two maps differ, what was decided.

use serde::Serialize;
use utoipa::ToSchema;

use super::ProgressAnswer;

/// What happened to the map since what was compacted.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = History)]
pub struct HistoryAnswer {
    /// Newest first.
    pub events: Vec<EventAnswer>,
    /// The oldest epoch that a map can be had of.
    pub oldest: u64,
    /// The newest.
    pub newest: u64,
}

/// Something that happened to the map.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Event)]
pub struct EventAnswer {
    /// The first record of it.
    pub first: u64,
    /// The last record of it: the epoch from which the map shows it.
    pub last: u64,
    /// UTC date it was written on.
    #[schema(format = Date)]
    pub date: String,
    /// What happened.
    #[serde(flatten)]
    pub what: Happened,
}

/// What may happen.
#[derive(Debug, Serialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Happened {
    /// Uploads came, one after the other on one day.
    Uploads {
        /// How many.
        uploads: u64,
        /// From how many contributors.
        contributors: u64,
        /// How many of them no longer count.
        taken_back: u64,
        /// How many of them vetting keeps out of the map; null while the map is made anew.
        #[schema(required)]
        quarantined: Option<u64>,
    },
    /// Tiles of another map's file came.
    Import {
        /// Id of the imported file.
        #[schema(format = "uuid")]
        file: String,
        /// How many tiles.
        tiles: u64,
        /// How many of them no longer count.
        taken_back: u64,
    },
    /// A contributor was revoked.
    RevokeContributor {
        /// The contributor's keyed hash, 16 hexadecimal digits. Null for viewers.
        #[schema(required)]
        of: Option<String>,
        /// Uploads that the decision takes back, for itself.
        takes_back: u64,
        /// Who, when and why.
        #[serde(flatten)]
        remarked: RemarkedAnswer,
    },
    /// An upload or an imported file was revoked.
    RevokeUpload {
        /// Its id.
        #[schema(format = "uuid")]
        of: String,
        /// Uploads and imported tiles that the decision takes back, for itself.
        takes_back: u64,
        /// Who, when and why.
        #[serde(flatten)]
        remarked: RemarkedAnswer,
    },
    /// Uploads and imports after an epoch were taken back.
    Rollback {
        /// The epoch.
        of: u64,
        /// Uploads and imported tiles that the decision takes back, for itself.
        takes_back: u64,
        /// Who, when and why.
        #[serde(flatten)]
        remarked: RemarkedAnswer,
    },
    /// A decision was undone.
    Undo {
        /// Number of its record.
        of: u64,
        /// Uploads and imported tiles that count again.
        gives_back: u64,
        /// Who, when and why.
        #[serde(flatten)]
        remarked: RemarkedAnswer,
    },
    /// Uploads were compacted.
    Settle {
        /// The last record that was.
        of: u64,
        /// Always 0.
        takes_back: u64,
        /// Who, when and why.
        #[serde(flatten)]
        remarked: RemarkedAnswer,
    },
}

/// Who decided, when and why.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Remarked)]
pub struct RemarkedAnswer {
    /// When it was decided, microseconds since the Unix epoch.
    pub at_us: i64,
    /// Who decided, where that is known.
    #[schema(required)]
    pub by: Option<String>,
    /// Why, where it was said.
    #[schema(required)]
    pub reason: Option<String>,
    /// The decision that undid it.
    #[schema(required)]
    pub undone_by: Option<u64>,
}

/// How two maps differ.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Difference)]
pub struct DifferenceAnswer {
    /// Cells of all tiles.
    pub cells: Cells,
    /// Tiles that differ.
    pub tiles_changed: usize,
    /// The first 10000 of them.
    pub tiles: Vec<TileDifference>,
}

/// Cells that differ between two maps.
#[derive(Debug, Serialize, ToSchema)]
pub struct Cells {
    /// Occupied cells only the later map has.
    pub added: u64,
    /// Occupied cells only the earlier map has.
    pub removed: u64,
    /// Cells both have, with other evidence.
    pub changed: u64,
}

/// A tile that differs.
#[derive(Debug, Serialize, ToSchema)]
pub struct TileDifference {
    /// EPSG code/x/y.
    pub id: String,
    /// Its cells.
    #[serde(flatten)]
    pub cells: Cells,
    /// South-west, south-east, north-east, north-west as longitude and latitude, degrees; null where the projection does not
    /// reach.
    #[schema(required)]
    pub corners: Option<[[f64; 2]; 4]>,
}

/// How the map of one epoch differs from that of another.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Diff)]
pub struct DiffAnswer {
    /// The earlier epoch.
    pub from: u64,
    /// The later epoch.
    pub to: u64,
    /// How they differ.
    #[serde(flatten)]
    pub difference: DifferenceAnswer,
}

/// Whether what is stored is sound.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Verified)]
pub struct VerifiedAnswer {
    /// Nothing is damaged.
    pub sound: bool,
    /// Records of the journal that were read.
    pub records: u64,
    /// Compacted tiles that were read.
    pub base_tiles: u64,
    /// Tiles that were read.
    pub tiles: u64,
    /// Tiles that were compared with a replay; null without one.
    #[schema(required)]
    pub compared: Option<u64>,
    /// What is wrong, in sentences.
    pub damage: Vec<String>,
}

/// What came of an imported file.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Imported)]
pub struct ImportedAnswer {
    /// The file's id; an import is revoked by it.
    #[schema(format = "uuid")]
    pub file: String,
    /// Tiles in the file.
    pub tiles: u64,
    /// Tiles of it that were imported before.
    pub known: u64,
    /// The map shows it from this epoch on.
    pub epoch: u64,
}

/// What came of a decision, or would come of it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Decided)]
#[serde(untagged)]
pub enum DecidedAnswer {
    /// It is on disk.
    Taken {
        /// Its epoch, from which on the map shows it; null when there was nothing to do.
        #[schema(required)]
        epoch: Option<u64>,
        /// How far the map is.
        map: ProgressAnswer,
    },
    /// It was only asked what it would change.
    Foretold {
        /// What it would change.
        dry_run: PreviewAnswer,
        /// How far the map is.
        map: ProgressAnswer,
    },
}

/// What a decision would change.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Preview)]
pub struct PreviewAnswer {
    /// Uploads.
    pub uploads: TakenAndGiven,
    /// Imported tiles.
    pub imported_tiles: TakenAndGiven,
    /// Distinct contributors of those uploads.
    pub contributors: u64,
    /// Uploads that nobody could take back or bring back any more.
    pub compacted: u64,
    /// Whether `undo` can take the decision back.
    pub can_be_undone: bool,
    /// How the map would differ.
    #[serde(flatten)]
    pub difference: DifferenceAnswer,
}

/// What a decision changes about what counts.
#[derive(Debug, Serialize, ToSchema)]
pub struct TakenAndGiven {
    /// Would no longer count.
    pub taken_back: u64,
    /// Would count again.
    pub given_back: u64,
}
