//! How the files of a cache are called.

use std::path::{Path, PathBuf};

use echofix_core::geo::{TileId, Zone};

const ENDING: &str = "tile";

/// A version of a tile, which names its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct TileVersionName {
    pub(super) id: TileId,
    pub(super) version: u64,
}

impl TileVersionName {
    /// Its file in a cache's folder.
    pub(super) fn path(self, dir: &Path) -> PathBuf {
        let Self { id: TileId { zone, x, y }, version } = self;
        dir.join(zone.epsg().to_string()).join(format!("{x}_{y}_{version}.{ENDING}"))
    }

    /// What a file of a zone's folder is called; none when it is no tile.
    pub(super) fn of(zone: Zone, path: &Path) -> Option<Self> {
        let mut numbers = path.file_stem()?.to_str()?.split('_');
        let (x, y) = (numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?);
        let version = numbers.next()?.parse().ok()?;
        let ours = numbers.next().is_none() && path.extension()? == ENDING;
        ours.then_some(Self { id: TileId { zone, x, y }, version })
    }
}
