//! All tiles in numbers, in memory.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use echofix_core::geo::{TileId, Zone};

use super::key::stamp;
use crate::store::api::{TileInfo, Totals};

/// The tiles, in order of their ids.
#[derive(Debug, Default)]
pub(in crate::store) struct Catalog {
    tiles: BTreeMap<TileId, TileInfo>,
    cells: u64,
    bytes: u64,
    newest_day: u16,
    digest: u64,
}

impl Catalog {
    /// Adds a tile or its new version.
    pub(in crate::store) fn put(&mut self, info: TileInfo) {
        self.digest = self.digest_with(&[info]);
        if let Some(before) = self.tiles.insert(info.id, info) {
            self.cells -= u64::from(before.cells);
            self.bytes -= u64::from(before.bytes);
        }
        self.cells += u64::from(info.cells);
        self.bytes += u64::from(info.bytes);
        self.newest_day = self.newest_day.max(info.newest_day);
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

    pub(in crate::store) fn totals(&self, uploads: u64) -> Totals {
        let Self { tiles, cells, bytes, newest_day, .. } = self;
        Totals { tiles: tiles.len() as u64, cells: *cells, bytes: *bytes, uploads, newest_day: *newest_day }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn info(epsg: u32, x: i32, y: i32, cells: u32) -> TileInfo {
        let id = TileId { zone: Zone::from_epsg(epsg).unwrap(), y, x };
        TileInfo { id, version: 1, cells, newest_day: 7, bytes: 2 * cells }
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
        let totals = catalog.totals(3);
        assert_eq!((totals.tiles, totals.cells, totals.bytes, totals.uploads), (2, 25, 50, 3));
        assert_eq!(catalog.zones().iter().map(|zone| zone.epsg()).collect::<Vec<_>>(), [32614, 32714]);
    }
}
