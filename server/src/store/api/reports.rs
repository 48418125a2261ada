//! What operations are given and what they report.

use std::time::Duration;

use echofix_core::geo::TileId;
use echofix_core::vetting::Reason;
use echofix_core::vetting::alarm::QuarantinedUpload;
use uuid::Uuid;

/// What folding has done since the service started; maps that are made anew are not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FoldingFigures {
    /// Time it took.
    pub spent: Duration,
    /// Uploads that agree with what others contributed there.
    pub agree: u64,
    /// Uploads of places that nobody else had contributed to.
    pub new: u64,
    /// Uploads that count unseen, because nothing is vetted.
    pub not_vetted: u64,
    /// Uploads that vetting kept out of the map.
    pub quarantined: u64,
}

/// Which part of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// Its limits as they were asked for: west, south, east, north, degrees.
    pub bounds_deg: [f64; 4],
    /// The tiles that touch it, by their ids.
    pub tiles: Vec<TileId>,
}

/// What an import did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Imported {
    /// The file's id: an import counts once, and is revoked, by it.
    pub file: Uuid,
    /// Tiles in the file.
    pub tiles: u64,
    /// Tiles of it that were in the journal before.
    pub known: u64,
    /// The map shows it from this epoch on.
    pub epoch: u64,
}

/// What a verification found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verified {
    /// Records of the journal that were read.
    pub records: u64,
    /// Tiles of the checkpoint that were read.
    pub checkpoint_tiles: u64,
    /// Tiles that were read.
    pub tiles: u64,
    /// Tiles that were compared with a replay; `None` when none was asked for.
    pub compared: Option<u64>,
    /// One sentence for each defect; empty when all is sound.
    pub damage: Vec<String>,
}

/// An upload that vetting kept out of the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuarantinedRecord {
    /// Number of the upload's record.
    pub number: u64,
    /// Why vetting kept it out.
    pub reason: Reason,
    /// Where it was, whose it was, and how far off.
    pub upload: QuarantinedUpload,
}
