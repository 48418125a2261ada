//! The map and the journal it is folded from.
//!
//! An upload is acknowledged once its record is in the journal and synced. Tiles are folded
//! from the journal in its order, and can be folded again from nothing. The embedded default has
//! the journal in checksummed segment files and the tiles in sled.
//!
//! - [`MapStore`]: what every storage engine offers, and its values.
//! - [`Operations`]: what operators may do with the map: its history, revocations, rollbacks.
//! - [`EmbeddedStore`]: the engine of one machine. Its parts, from the disk upwards: `data_dir` (layout,
//!   lock, key), `options` and `clock`, `checksum`, `journal`, `entry` and `record` (a record's bytes), `index` (which records there are),
//!   `exclusion` (which of them count), `checkpoint` (what stands for compacted records), `key`, `pieces` and `tiles` (sled),
//!   `generation` and `catalog`, `write_buffer` and `vetting` and `fold` (records to tiles), `quarantine`, `build` (new generations),
//!   `manifest` (which one is served), `fold_worker` (the thread that does it), `history` (the map's past),
//!   `region` (export and import), `backup`, `verify`.
//!
//! Every state of the map is a function of the checkpoint and the journal's records up to the epoch, without what
//! the controls among them exclude. Generations of tiles are that function's values, stored.

mod attempt;
mod backup;
mod build;
mod catalog;
mod checkpoint;
mod checksum;
mod clock;
mod context;
mod data_dir;
mod embedded;
mod entry;
mod exclusion;
mod faults;
mod fold;
mod fold_worker;
mod generation;
mod history;
mod index;
mod journal;
mod key;
mod manifest;
mod operations;
mod options;
mod pieces;
mod policy;
mod quarantine;
mod record;
mod region;
mod room;
mod sled_instance;
mod stream;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod tiles;
mod verify;
mod vetting;
mod write_buffer;

pub use clock::StoreClock;
pub use embedded::EmbeddedStore;
pub use history::{Decision, EventKind, HistoryEvent, Snapshot, TileDiff};
pub use operations::Operations;
pub use options::Options;
pub use policy::Policy;
pub use region::{Imported, Region};
pub use verify::Verified;
pub use vetting::QuarantinedRecord;

use std::ops::RangeInclusive;
use std::sync::Arc;

use echofix_core::datum::PoseSigma;
use echofix_core::evidence::{EvidenceDelta, Pass};
use echofix_core::geo::{TileId, Zone};
use echofix_core::tile::{self, Tile};
use tokio::sync::watch;
use uuid::Uuid;

/// Why the store could not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The disk refused.
    #[error("{doing}: {source}")]
    Io {
        /// The step that failed, as a phrase: "writing the journal".
        doing: &'static str,
        /// What the operating system reported.
        source: std::io::Error,
    },
    /// The tile store refused.
    #[error("tile store: {0}")]
    Tiles(#[from] sled::Error),
    /// The tile store failed before, and takes nothing more. Another one is made in its place.
    #[error("the tile store failed: {0}")]
    Broken(String),
    /// The disk is so full that nothing but the journal is written.
    #[error("{free_mib} MiB are free in {dir}, and folding needs {needed_mib}; free some")]
    NoRoom {
        /// The data directory.
        dir: String,
        /// What is free, MiB.
        free_mib: u64,
        /// What must be, MiB.
        needed_mib: u64,
    },
    /// Stored bytes do not pass their checks.
    #[error("{what} is damaged: {reason}")]
    Damaged {
        /// The record, tile or file.
        what: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Another process has the data directory open.
    #[error("{0} is in use by another server; give each its own data directory")]
    InUse(String),
    /// The map is being folded from the journal and is not whole yet.
    #[error("the map is being rebuilt: {folded} of {journaled} uploads are folded; try again later")]
    Rebuilding {
        /// The last record folded.
        folded: u64,
        /// The last record in the journal.
        journaled: u64,
    },
    /// There is nothing under this name.
    #[error("{0}")]
    Unknown(String),
    /// What was given cannot be used.
    #[error("{0}")]
    Unusable(String),
    /// The store accepts nothing any more: another service has its directory, or it is being closed.
    #[error("the store stopped: {0}")]
    Stopped(String),
}

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
}

/// Can the map be read?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MapStatus {
    /// Not yet: it does not show all uploads that were counted before the start.
    #[default]
    Rebuilding,
    /// Yes.
    Serving,
    /// As of the epoch; folding on fails and is tried again.
    Stalled,
}

/// How far the journal reaches and how far it is folded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MapProgress {
    /// Can the map be read?
    pub state: MapStatus,
    /// Epoch of the map that is served: the number of the last record folded into it.
    pub epoch: u64,
    /// Number of the last record in the journal.
    pub journaled: u64,
    /// A new generation of the map that is being made, under a control. What is served meanwhile, if
    /// anything, does not show the control yet.
    pub building: Option<Building>,
    /// The journal accepts nothing any more, see [`Error::Stopped`].
    pub stopped: bool,
    /// The journal could not be written the last time; it is tried again.
    pub refusing: bool,
}

/// A generation of the map that is being made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Building {
    /// The last record folded into it.
    pub folded: u64,
    /// Number of the last record in the journal.
    pub of: u64,
    /// Number of the control it is made under; 0 when it replaces lost tiles.
    pub control: u64,
}

fn io_error(doing: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |source| Error::Io { doing, source }
}

/// The map and its journal. Every call may block on the disk: keep it off the async threads.
pub trait MapStore: Send + Sync {
    /// Keyed hash of a contributor's pseudonym; the key never leaves the store.
    fn contributor(&self, pseudonym: &str) -> u64;

    /// Distinguishes this history of the map from others that may give its versions to other tiles: drawn anew where a
    /// backup is restored, and where the manifest was deleted to continue the map without lost records.
    fn lineage(&self) -> u64;

    /// The wire version: equal ones stand for equal evidence, of whichever lineage they are.
    fn wire_version(&self, version: u64) -> u64 {
        self.lineage().wrapping_add(version)
    }

    /// Writes an upload to the journal and syncs it, exactly once by its id. Folding follows in
    /// the background, see [`MapStore::progress`].
    ///
    /// # Errors
    /// When it is not certain that the upload is on disk; it must not be acknowledged then.
    fn commit(&self, upload: UploadRecord) -> Result<Receipt, Error>;

    /// What was answered to an upload id that was counted before.
    ///
    /// # Errors
    /// When the disk refuses or the record is damaged.
    fn counted(&self, id: Uuid) -> Result<Option<Receipt>, Error>;

    /// One tile, in its newest version; `None` where nothing is served.
    ///
    /// # Errors
    /// When the disk refuses, the tile is damaged, or the map is being rebuilt.
    fn tile(&self, id: TileId) -> Result<Option<StoredTile>, Error>;

    /// The catalog's entries of a zone's block of tiles, in order of their id.
    ///
    /// # Errors
    /// When the disk refuses or the map is being rebuilt.
    fn catalog(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Vec<TileInfo>, Error>;

    /// The zones that hold any tile.
    fn zones(&self) -> Vec<Zone>;

    /// The whole map in numbers.
    fn totals(&self) -> Totals;

    /// Follows how far the journal reaches and how far it is folded.
    fn progress(&self) -> watch::Receiver<MapProgress>;

    /// What has stopped for good, so that only a restart helps; `None` while all works or is tried again.
    fn hang(&self) -> Option<String> {
        None
    }
}
