//! The map as it will be served next.

use std::sync::Arc;

use echofix_core::geo::TileId;
use echofix_core::tile::Tile;

use super::Error;

/// The map as it will be served next, before anybody reads it.
pub trait UpcomingMap {
    /// Last UTC day anything was seen in it, counted from the Unix epoch.
    fn newest_day(&self) -> u16;

    /// Version of a tile; 0 where nothing is served.
    fn version(&self, id: TileId) -> u64;

    /// A tile as it will be published; `None` where nothing is served. Tiles that did not change are read from the disk.
    ///
    /// # Errors
    /// When the disk refuses or the tile is damaged.
    fn tile(&self, id: TileId) -> Result<Option<Arc<Tile>>, Error>;

    /// Is there time to prepare for it? Not once the end was called.
    fn goes_on(&self) -> bool;
}

/// Prepares for a map, which is served when this returns.
pub type Preparing = Box<dyn Fn(&dyn UpcomingMap) + Send + Sync>;
