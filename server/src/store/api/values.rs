//! Uploads and tiles, as they come and as they are served.

use std::sync::Arc;

use echofix_core::datum::PoseSigma;
use echofix_core::evidence::{Cell, EvidenceDelta, Pass};
use echofix_core::geo::TileId;
use echofix_core::tile::{self, Decay, Ledger, Standing, Tile};
use uuid::Uuid;

/// An upload as a record of the journal.
#[derive(Debug, Clone, PartialEq)]
pub struct UploadRecord {
    /// Chosen by the contributor; an upload counts once by it.
    pub id: Uuid,
    /// The contributor's hash and the day of the drive.
    pub pass: Pass,
    /// Uploads of days before this one are no longer taken, so the votes of their passes may be
    /// forgotten; 0 forgets none. It is in the record, so that folding it again gives the same.
    pub forget_before: u16,
    /// How well the poses are known that it was mapped from, as declared. `None` in records of before there were
    /// declarations: they are vetted and folded as they were then.
    pub declared: Option<PoseSigma>,
    /// Its evidence delta. Near a zone border it holds the tiles of both zones.
    pub contribution: EvidenceDelta,
    /// The answer that was given, repeated to retries (an encoded `UploadResponse`).
    pub answer: Vec<u8>,
}

/// What became of a commit.
#[derive(Debug, Clone, PartialEq)]
pub enum Receipt {
    /// Counted, and on disk.
    Counted {
        /// The map shows it from this epoch on.
        epoch: u64,
    },
    /// This id was counted before.
    Duplicate {
        /// The map shows it from this epoch on.
        epoch: u64,
        /// The answer that was given when it was counted, an encoded `UploadResponse`.
        answer: Vec<u8>,
    },
}

/// A tile as it is served.
#[derive(Debug, Clone)]
pub struct StoredTile {
    /// Epoch of the tile's last change. In one lineage a version stands for the same evidence for ever; what is
    /// served of it fades as the map's newest day moves on.
    pub version: u64,
    /// Newest day of the map as of which it is published: what fades is another tile on another day.
    pub day: u16,
    /// The evidence that is published of it.
    pub tile: Arc<Tile>,
}

impl StoredTile {
    /// The tile in the codec of [`echofix_core::tile`]: made when it is asked for, since few readers want it.
    #[must_use]
    pub fn encoded(&self) -> Vec<u8> {
        tile::encode(&self.tile)
    }
}

/// A tile with all that is known of it, unpublished cells included: for operators.
#[derive(Debug, Clone)]
pub struct InspectedTile {
    /// Epoch of the tile's last change.
    pub version: u64,
    /// The evidence.
    pub tile: Tile,
    /// Who said what of it lately.
    pub ledger: Ledger,
    /// Distinct contributors that are needed for a cell to be served.
    pub needed: u8,
    /// The map's newest day, from which decay is counted; `None` where nothing decays.
    pub today: Option<u16>,
    /// How evidence decays.
    pub decay: Decay,
}

impl InspectedTile {
    /// Whether a cell of it is served, by its index.
    #[must_use]
    pub fn standing(&self, (index, cell): (u32, &Cell)) -> Standing {
        self.tile.standing((index, cell), self.needed, self.today, &self.decay)
    }
}

/// What the catalog says about a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileInfo {
    /// Its id.
    pub id: TileId,
    /// Epoch of its last change.
    pub version: u64,
    /// Cells that enough contributors support, for them to be served.
    pub cells: u32,
    /// Last UTC day anything was seen, counted from the Unix epoch.
    pub newest_day: u16,
    /// Bytes of the encoded tile.
    pub bytes: u32,
    /// The most contributors that support any of it, where no cell is served yet; 0 where one is, or nothing was hit.
    pub waiting: u8,
}

/// Evidence that is not served, because too few contributors support it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Withheld {
    /// The most contributors that support any of it.
    pub contributors: u8,
    /// Contributors that are needed.
    pub needed: u8,
}

/// The whole map in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Totals {
    /// Tiles that hold any evidence.
    pub tiles: u64,
    /// Occupied cells.
    pub cells: u64,
    /// Bytes of encoded tiles.
    pub bytes: u64,
    /// Uploads counted since the journal began, compacted and revoked ones too.
    pub uploads: u64,
    /// Last UTC day anything was seen, counted from the Unix epoch.
    pub newest_day: u16,
    /// Of the tiles, those of which nothing is served yet, because too few contributors support it.
    pub waiting_tiles: u64,
    /// The most contributors that support anything in one of those; 0 without any.
    pub waiting_contributors: u8,
    /// Contributors that are needed for something to be served; 0 where that is not known.
    pub needed: u8,
}
