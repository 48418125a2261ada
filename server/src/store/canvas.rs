//! The tiles that a group of records changes, while they are folded.

use std::collections::BTreeMap;

use echofix_core::geo::TileId;
use echofix_core::tile::{Ledger, Tile};

use super::Error;

/// A tile and what folding needs of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Folded {
    /// Number of the last record that changed it; 0 for none.
    pub(super) version: u64,
    pub(super) tile: Tile,
    pub(super) ledger: Ledger,
}

/// A map that is folded into.
pub(super) trait Source {
    /// The tile as it is folded on; empty where there is none.
    fn folded(&self, id: TileId) -> Result<Folded, Error>;
}

/// Tiles in memory.
pub(super) type InMemory = BTreeMap<TileId, Folded>;

impl Source for InMemory {
    fn folded(&self, id: TileId) -> Result<Folded, Error> {
        Ok(self.get(&id).cloned().unwrap_or_default())
    }
}

/// A map, and in memory the tiles of it that were looked at or changed.
pub(super) struct Canvas<'a> {
    source: &'a dyn Source,
    tiles: BTreeMap<TileId, Touched>,
}

struct Touched {
    folded: Folded,
    changed: bool,
}

impl<'a> Canvas<'a> {
    pub(super) fn new(source: &'a dyn Source) -> Self {
        Self { source, tiles: BTreeMap::new() }
    }

    /// A tile that the record of this number changes.
    pub(super) fn change(&mut self, id: TileId, number: u64) -> Result<&mut Folded, Error> {
        let touched = self.touch(id)?;
        touched.changed = true;
        touched.folded.version = number;
        Ok(&mut touched.folded)
    }

    /// A tile as it is by now; empty where there is none.
    pub(super) fn get(&mut self, id: TileId) -> Result<&Folded, Error> {
        Ok(&self.touch(id)?.folded)
    }

    /// A tile that was looked at before.
    pub(super) fn looked_at(&self, id: TileId) -> Option<&Folded> {
        self.tiles.get(&id).map(|touched| &touched.folded)
    }

    fn touch(&mut self, id: TileId) -> Result<&mut Touched, Error> {
        use std::collections::btree_map::Entry;
        Ok(match self.tiles.entry(id) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(Touched { folded: self.source.folded(id)?, changed: false }),
        })
    }

    /// The tiles that were changed.
    pub(super) fn into_changed(self) -> impl Iterator<Item = (TileId, Folded)> {
        let changed = self.tiles.into_iter().filter(|(_, touched)| touched.changed);
        changed.map(|(id, touched)| (id, touched.folded))
    }
}
