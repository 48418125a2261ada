//! How the files of a cache are called.

use std::path::{Path, PathBuf};

use echofix_core::geo::{TileId, Zone};

/// What a cache has of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Form {
    /// All that is served of it.
    Tile,
    /// Its vehicle layer.
    Layer,
}

impl Form {
    /// How its files end.
    fn ending(self) -> &'static str {
        match self {
            Self::Tile => "tile",
            Self::Layer => "layer",
        }
    }
}

/// A version of a tile in a form, which names its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct TileVersionName {
    pub(super) id: TileId,
    pub(super) version: u64,
    pub(super) form: Form,
}

impl TileVersionName {
    /// Its file in a cache's folder.
    pub(super) fn path(self, dir: &Path) -> PathBuf {
        let Self { id: TileId { zone, x, y }, version, form } = self;
        dir.join(zone.epsg().to_string()).join(format!("{x}_{y}_{version}.{}", form.ending()))
    }

    /// What a file of a zone's folder is called; none when it is no tile.
    pub(super) fn of(zone: Zone, path: &Path) -> Option<Self> {
        let mut numbers = path.file_stem()?.to_str()?.split('_');
        let (x, y) = (numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?);
        let version = numbers.next()?.parse().ok()?;
        let form = [Form::Tile, Form::Layer]
            .into_iter()
            .find(|form| path.extension().is_some_and(|e| e == form.ending()))?;
        numbers.next().is_none().then_some(Self { id: TileId { zone, x, y }, version, form })
    }
}
