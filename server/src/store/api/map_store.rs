//! What every storage engine offers to who reads the map and who adds to it.

use std::ops::RangeInclusive;

use echofix_core::geo::{TileId, Zone};
use tokio::sync::watch;
use uuid::Uuid;

use super::{
    Error, InspectedTile, MapProgress, Preparing, Receipt, StoredTile, TileInfo, Totals, UploadRecord,
    Withheld,
};

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

    /// One tile with all that is known of it, served or not; `None` where nothing was hit.
    ///
    /// # Errors
    /// As [`MapStore::tile`], or when this map knows only what is served.
    fn inspect(&self, id: TileId) -> Result<Option<InspectedTile>, Error> {
        Err(Error::Unusable(format!("this map knows only what is served of tile {id}")))
    }

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

    /// What tiles of a zone's block hold of which nothing is served yet; `None` where there are none.
    ///
    /// # Errors
    /// When the disk refuses, a tile is damaged, or the map is being rebuilt.
    fn withheld(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Option<Withheld>, Error>;

    /// The zones that hold any tile.
    fn zones(&self) -> Vec<Zone>;

    /// The whole map in numbers.
    fn totals(&self) -> Totals;

    /// Last UTC day anything was seen in the map, counted from the Unix epoch. Asked for with each fix: it waits for little.
    fn newest_day(&self) -> u16 {
        self.totals().newest_day
    }

    /// Lets somebody prepare for each state of the map before it is served, on the thread that folds. A map that does not change
    /// asks nobody.
    fn before_serving(&self, prepare: Preparing) {
        drop(prepare);
    }

    /// Follows how far the journal reaches and how far it is folded.
    fn progress(&self) -> watch::Receiver<MapProgress>;

    /// The addresses at which vehicles reach the services that share this map and live, this one's own among them, in order;
    /// `None` where it has none, or shares with nobody.
    fn replicas(&self) -> Option<watch::Receiver<Vec<String>>> {
        None
    }

    /// What has stopped for good, so that only a restart helps; `None` while all works or is tried again.
    fn hang(&self) -> Option<String> {
        None
    }
}
