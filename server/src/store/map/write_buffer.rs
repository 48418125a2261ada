//! The write buffer: the tiles that a group of records reads and changes while they are folded.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use echofix_core::geo::TileId;
use echofix_core::tile::{Ledger, Tile};

use crate::store::api::Error;

/// A tile and what folding needs of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(in crate::store) struct Folded {
    /// Number of the last record that changed it; 0 for none.
    pub(in crate::store) version: u64,
    pub(in crate::store) tile: Tile,
    pub(in crate::store) ledger: Ledger,
}

/// A map that is folded into.
pub(in crate::store) trait Source {
    /// The tile as it is folded on; empty where there is none.
    fn folded(&self, id: TileId) -> Result<Folded, Error>;
}

/// Tiles in memory.
pub(in crate::store) type InMemory = BTreeMap<TileId, Folded>;

impl Source for InMemory {
    fn folded(&self, id: TileId) -> Result<Folded, Error> {
        Ok(self.get(&id).cloned().unwrap_or_default())
    }
}

/// A map, and in memory the tiles of it that were read or changed.
pub(super) struct WriteBuffer<'a> {
    source: &'a dyn Source,
    /// Tiles from which on they are written before more is folded.
    capacity: usize,
    tiles: BTreeMap<TileId, Touched>,
    /// What is seen where there is no tile. It is not stored for each of them: uploads may ask for any number.
    nothing: Folded,
}

struct Touched {
    folded: Folded,
    changed: bool,
}

impl<'a> WriteBuffer<'a> {
    pub(in crate::store) fn new(source: &'a dyn Source, capacity: usize) -> Self {
        Self { source, capacity, tiles: BTreeMap::new(), nothing: Folded::default() }
    }

    /// Must its tiles be written before more is folded?
    pub(super) fn is_full(&self) -> bool {
        self.tiles.len() >= self.capacity
    }

    /// A tile that the record of this number changes.
    pub(in crate::store) fn change(&mut self, id: TileId, number: u64) -> Result<&mut Folded, Error> {
        let touched = match self.tiles.entry(id) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(Touched { folded: self.source.folded(id)?, changed: false }),
        };
        touched.changed = true;
        touched.folded.version = number;
        Ok(&mut touched.folded)
    }

    /// A tile as it is by now; empty where there is none.
    pub(in crate::store) fn get(&mut self, id: TileId) -> Result<&Folded, Error> {
        match self.tiles.entry(id) {
            Entry::Occupied(entry) => Ok(&entry.into_mut().folded),
            Entry::Vacant(entry) => {
                let folded = self.source.folded(id)?;
                let is_one = folded.version != 0;
                Ok(if is_one {
                    &entry.insert(Touched { folded, changed: false }).folded
                } else {
                    &self.nothing
                })
            }
        }
    }

    /// A tile that was read before; `None` also where there is none.
    pub(super) fn looked_at(&self, id: TileId) -> Option<&Folded> {
        self.tiles.get(&id).map(|touched| &touched.folded)
    }

    /// The tiles that were changed.
    pub(super) fn into_changed(self) -> impl Iterator<Item = (TileId, Folded)> {
        let changed = self.tiles.into_iter().filter(|(_, touched)| touched.changed);
        changed.map(|(id, touched)| (id, touched.folded))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::testing::some_uploads;

    /// Catches: an upload of tiles far apart that takes a hundred times as much memory as it has tiles.
    #[test]
    fn what_is_not_there_takes_no_memory() {
        let source = InMemory::new();
        let mut buffer = WriteBuffer::new(&source, 1);
        let id = *some_uploads(1)[0].contribution.tiles.keys().next().unwrap();
        assert_eq!(buffer.get(id).unwrap(), &Folded::default());
        assert!(buffer.looked_at(id).is_none() && buffer.tiles.is_empty());
        assert_eq!(buffer.change(id, 7).unwrap().version, 7);
        assert_eq!(buffer.get(id).unwrap().version, 7);
        assert_eq!(buffer.into_changed().count(), 1);
    }
}
