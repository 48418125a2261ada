//! All tiles in numbers, in memory.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use echofix_core::geo::{TileId, Zone};

use super::key::stamp;
use crate::store::api::{TileInfo, Totals, Withheld};

/// The tiles, in order of their ids.
#[derive(Debug, Default)]
pub(in crate::store) struct Catalog {
    tiles: BTreeMap<TileId, TileInfo>,
    cells: u64,
    bytes: u64,
    newest_day: u16,
    digest: u64,
    /// Tiles of which nothing is served yet, by the most contributors that support any of them.
    waiting: BTreeMap<u8, u64>,
}

impl Catalog {
    /// Adds a tile or its new version.
    pub(in crate::store) fn put(&mut self, info: TileInfo) {
        self.digest = self.digest_with(&[info]);
        if let Some(before) = self.tiles.insert(info.id, info) {
            self.cells -= u64::from(before.cells);
            self.bytes -= u64::from(before.bytes);
            self.waits(before.waiting, -1);
        }
        self.waits(info.waiting, 1);
        self.cells += u64::from(info.cells);
        self.bytes += u64::from(info.bytes);
        self.newest_day = self.newest_day.max(info.newest_day);
    }

    /// So many tiles more, or fewer, wait with so many contributors.
    fn waits(&mut self, contributors: u8, tiles: i64) {
        if contributors == 0 {
            return;
        }
        let left = self.waiting.entry(contributors).or_default();
        *left = left.saturating_add_signed(tiles);
        if *left == 0 {
            self.waiting.remove(&contributors);
        }
    }

    /// Sum of what all tiles are stamped with, once these are added, by which is checked whether a set of stored tiles
    /// is whole and of one time.
    pub(super) fn digest_with(&self, infos: &[TileInfo]) -> u64 {
        let changed = infos.iter().fold(self.digest, |digest, info| digest.wrapping_add(stamp(info)));
        let before = infos.iter().filter_map(|info| self.tiles.get(&info.id));
        before.fold(changed, |digest, info| digest.wrapping_sub(stamp(info)))
    }

    pub(in crate::store) fn digest(&self) -> u64 {
        self.digest
    }

    /// All entries, in order of their ids.
    pub(in crate::store) fn all(&self) -> impl Iterator<Item = &TileInfo> {
        self.tiles.values()
    }

    /// The newest day anything was seen.
    pub(in crate::store) fn newest_day(&self) -> u16 {
        self.newest_day
    }

    pub(in crate::store) fn get(&self, id: TileId) -> Option<&TileInfo> {
        self.tiles.get(&id)
    }

    /// The entries of a zone's block, in order of their ids.
    pub(in crate::store) fn block(
        &self,
        zone: Zone,
        x: &RangeInclusive<i32>,
        y: &RangeInclusive<i32>,
    ) -> Vec<TileInfo> {
        let mut found = Vec::new();
        let (left, right) = (*x.start(), *x.end());
        let mut from = Some(TileId { zone, y: *y.start(), x: left });
        let end = TileId { zone, y: *y.end(), x: right };
        // Leaps over what lies left and right of the block, row by row.
        while let Some(start) = from.filter(|start| *start <= end) {
            let Some((id, info)) = self.tiles.range(start..=end).next() else { break };
            from = if id.x < left {
                Some(TileId { x: left, ..*id })
            } else if id.x > right {
                id.y.checked_add(1).map(|y| TileId { y, x: left, ..*id })
            } else {
                found.push(*info);
                match id.x.checked_add(1) {
                    Some(x) => Some(TileId { x, ..*id }),
                    None => id.y.checked_add(1).map(|y| TileId { y, x: left, ..*id }),
                }
            };
        }
        found
    }

    /// What tiles of a zone's block hold of which nothing is served yet.
    pub(in crate::store) fn withheld(
        &self,
        (zone, x, y): (Zone, &RangeInclusive<i32>, &RangeInclusive<i32>),
        needed: u8,
    ) -> Option<Withheld> {
        let most = self.block(zone, x, y).iter().map(|info| info.waiting).max();
        most.filter(|most| *most > 0).map(|contributors| Withheld { contributors, needed })
    }

    pub(in crate::store) fn zones(&self) -> Vec<Zone> {
        let mut zones = Vec::new();
        let mut next = self.tiles.keys().next();
        while let Some(id) = next {
            zones.push(id.zone);
            let last = TileId { zone: id.zone, y: i32::MAX, x: i32::MAX };
            next = self.tiles.range(last..).map(|(id, _)| id).find(|id| id.zone != last.zone);
        }
        zones
    }

    /// The map in numbers, when so many contributors are needed for something to be served.
    pub(in crate::store) fn totals(&self, uploads: u64, needed: u8) -> Totals {
        Totals {
            tiles: self.tiles.len() as u64,
            cells: self.cells,
            bytes: self.bytes,
            uploads,
            newest_day: self.newest_day,
            waiting_tiles: self.waiting.values().sum(),
            waiting_contributors: self.waiting.last_key_value().map_or(0, |(contributors, _)| *contributors),
            needed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn info(epsg: u32, x: i32, y: i32, cells: u32) -> TileInfo {
        let id = TileId { zone: Zone::from_epsg(epsg).unwrap(), y, x };
        TileInfo { id, version: 1, cells, newest_day: 7, bytes: 2 * cells, waiting: 0 }
    }

    proptest! {
        #[test]
        fn a_block_is_what_a_full_search_finds(
            ids in prop::collection::btree_set((32613..32616_u32, -5..5, -5..5), 0..80),
            x in (-6..6, -6..6), y in (-6..6, -6..6),
        ) {
            let mut catalog = Catalog::default();
            for (epsg, x, y) in &ids {
                catalog.put(info(*epsg, *x, *y, 1));
            }
            let zone = Zone::from_epsg(32614).unwrap();
            let found = catalog.block(zone, &(x.0..=x.1), &(y.0..=y.1));
            prop_assert!(found.is_sorted_by_key(|info| info.id));
            let expected = ids.iter().filter(|(epsg, a, b)| {
                *epsg == 32614 && (x.0..=x.1).contains(a) && (y.0..=y.1).contains(b)
            });
            prop_assert_eq!(found.len(), expected.count());
            let all = catalog.block(zone, &(i32::MIN..=i32::MAX), &(i32::MIN..=i32::MAX));
            prop_assert_eq!(all.len(), ids.iter().filter(|(epsg, _, _)| *epsg == 32614).count());
        }
    }

    #[test]
    fn totals_follow_new_versions() {
        let mut catalog = Catalog::default();
        catalog.put(info(32614, 1, 1, 10));
        catalog.put(info(32714, 1, 1, 5));
        catalog.put(info(32614, 1, 1, 20));
        let totals = catalog.totals(3, 3);
        assert_eq!((totals.tiles, totals.cells, totals.bytes, totals.uploads), (2, 25, 50, 3));
        assert_eq!(catalog.zones().iter().map(|zone| zone.epsg()).collect::<Vec<_>>(), [32614, 32714]);
    }

    /// Catches: tiles that are counted as waiting after they are served, or twice as more contributors come.
    #[test]
    fn tiles_wait_until_they_are_served() {
        let mut catalog = Catalog::default();
        let waiting = |x, contributors| TileInfo { waiting: contributors, ..info(32614, x, 1, 0) };
        let told = |catalog: &Catalog| {
            let Totals { waiting_tiles, waiting_contributors, needed, .. } = catalog.totals(0, 3);
            (waiting_tiles, waiting_contributors, needed)
        };
        assert_eq!(told(&catalog), (0, 0, 3));
        catalog.put(waiting(1, 1));
        catalog.put(waiting(2, 1));
        assert_eq!(told(&catalog), (2, 1, 3));
        catalog.put(waiting(1, 2));
        assert_eq!(told(&catalog), (2, 2, 3));
        catalog.put(info(32614, 1, 1, 10));
        assert_eq!(told(&catalog), (1, 1, 3));
        catalog.put(info(32614, 2, 1, 10));
        assert_eq!(told(&catalog), (0, 0, 3));
    }
}
