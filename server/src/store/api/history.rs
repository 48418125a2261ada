//! What happened to the map, how it looked, what changed.

use std::collections::BTreeMap;

use echofix_core::geo::TileId;
use echofix_core::tile::Tile;
use uuid::Uuid;

use super::{Decision, Remark};

/// Something that happened to the map, newest epochs first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HistoryEvent {
    /// The first record of it.
    pub first: u64,
    /// The last record of it: the epoch from which the map shows it.
    pub last: u64,
    /// UTC day it was written on, counted from the Unix epoch.
    pub day: u16,
    /// Its kind, and what it did.
    pub what: EventKind,
}

/// What may happen to the map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EventKind {
    /// Uploads came, one after the other on one day.
    Uploads {
        /// Number of the uploads.
        uploads: u64,
        /// Number of their contributors.
        contributors: u64,
        /// Number of the uploads that no longer count.
        taken_back: u64,
    },
    /// Tiles of another map's file came.
    Import {
        /// Id of the file they came in.
        file: Uuid,
        /// Number of the tiles.
        tiles: u64,
        /// Number of the tiles that no longer count.
        taken_back: u64,
    },
    /// An operator decided.
    Control {
        /// Time of the decision, microseconds since the Unix epoch.
        at_us: i64,
        /// The decision.
        decision: Decision,
        /// Uploads and imported tiles it takes back, for itself; when it undoes another decision, those that this one took
        /// back.
        takes_back: u64,
        /// Who decided, and why.
        remark: Remark,
        /// The decision that undid it.
        undone_by: Option<u64>,
    },
}

/// A map of the past.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Snapshot {
    /// Number of the last record in it.
    pub epoch: u64,
    /// All its tiles by their ids, unpublished cells included.
    pub tiles: BTreeMap<TileId, Tile>,
}

/// How a tile of one map differs from the same of another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileDiff {
    /// The tile that differs.
    pub id: TileId,
    /// Occupied cells that only the later map has.
    pub added: u32,
    /// Occupied cells that only the earlier map has.
    pub removed: u32,
    /// Occupied cells that both have, and not with the same evidence.
    pub changed: u32,
}

impl Snapshot {
    /// How the tiles of a later map differ from this one's, in order of their ids; equal ones are left
    /// out.
    #[must_use]
    pub fn diff(&self, later: &Self) -> Vec<TileDiff> {
        let nothing = Tile::default();
        let mut ids: Vec<_> = self.tiles.keys().chain(later.tiles.keys()).copied().collect();
        ids.sort_unstable();
        ids.dedup();
        let of = |snapshot: &'_ Self, id: &TileId| snapshot.tiles.get(id).unwrap_or(&nothing).clone();
        let diffs = ids.into_iter().map(|id| compare(id, &of(self, &id), &of(later, &id)));
        diffs.filter(|diff| diff.added + diff.removed + diff.changed > 0).collect()
    }
}

fn compare(id: TileId, earlier: &Tile, later: &Tile) -> TileDiff {
    let mut diff = TileDiff { id, added: 0, removed: 0, changed: 0 };
    let mut old = earlier.cells().iter().peekable();
    for (index, cell) in later.cells() {
        while old.next_if(|(before, _)| before < index).is_some() {
            diff.removed += 1;
        }
        match old.next_if(|(same, _)| same == index) {
            Some((_, before)) => diff.changed += u32::from(before != cell),
            None => diff.added += 1,
        }
    }
    diff.removed += old.count() as u32;
    diff
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::evidence::Cell;

    #[test]
    fn differing_cells_are_counted() {
        let cell = |hits| Cell { hits, ..Cell::default() };
        let tile = |cells: &[(u32, u32)]| {
            Tile::from_cells(cells.iter().map(|(index, hits)| (*index, cell(*hits))).collect()).unwrap()
        };
        let id = TileId { zone: echofix_core::geo::Zone::from_epsg(32614).unwrap(), y: 0, x: 0 };
        let (earlier, later) = (tile(&[(1, 1), (2, 1), (5, 1), (9, 1)]), tile(&[(2, 1), (3, 1), (5, 2)]));
        let diff = compare(id, &earlier, &later);
        assert_eq!(diff, TileDiff { id, added: 1, removed: 2, changed: 1 });
        let back = compare(id, &later, &earlier);
        assert_eq!(back, TileDiff { id, added: 2, removed: 1, changed: 1 });
    }
}
