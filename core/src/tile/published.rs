//! What is served of a tile.

use super::Tile;
use crate::evidence::{Cell, SUPPORT_BLOCKS, VIEW_BLOCKS, support_block, view_block};

/// How evidence that nobody confirms loses its worth. Passes that look and do not find it make it fade
/// much sooner; this is for streets where nobody drives any more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decay {
    /// Days after which an unconfirmed cell's presence is half as high. After as many more, a
    /// quarter: roadworks last months, facades years.
    pub half_life_days: f64,
    /// Cells that were last hit longer ago are not served at all, days.
    pub expire_days: u16,
}

impl Default for Decay {
    fn default() -> Self {
        Self { half_life_days: 180.0, expire_days: 365 }
    }
}

impl Decay {
    /// The cell as it is worth on a day; `None` once it has expired.
    pub(super) fn applied(&self, cell: Cell, today: u16) -> Option<Cell> {
        let age_days = today.saturating_sub(cell.last_day);
        let left = (-f64::from(age_days) / self.half_life_days).exp2();
        let presence = (f64::from(cell.presence) * left).round() as u16;
        (age_days <= self.expire_days && presence > 0).then_some(Cell { presence, ..cell })
    }
}

/// Passes with a block in view, from which on a cell there must have been hit by two, and not by one where others hit
/// something beside it: what stands has been hit again by then, and strangers' clutter lies beside everything.
pub(super) const WELL_SEEN: u16 = 6;
/// Distinct contributors that must have hit a cell of a block that is [well seen](WELL_SEEN).
pub(super) const WELL_SEEN_CONTRIBUTORS: u8 = 2;

impl Tile {
    /// Cells that enough contributors vouch for: at least `min_contributors` distinct ones have hit something in
    /// the same support block, and where many passes had it in view, two of them the cell itself.
    pub fn supported(&self, min_contributors: u8) -> impl Iterator<Item = &(u32, Cell)> {
        let alone = min_contributors.min(WELL_SEEN_CONTRIBUTORS);
        self.cells.iter().filter(move |(index, cell)| {
            let own = cell.contributors >= alone || self.observed[view_block(*index)] < WELL_SEEN;
            own && self.support[support_block(*index)] >= min_contributors
        })
    }

    /// The tile that is served: cells that enough contributors vouch for, see [`Tile::supported`], decayed to `today` (a UTC day counted from the Unix epoch; nothing decays
    /// without it). What is known of blocks stays only where there are such cells, so that nothing
    /// shows where fewer contributors drove.
    #[must_use]
    pub fn published(&self, min_contributors: u8, today: Option<u16>, decay: &Decay) -> Self {
        let worth = |cell: Cell| today.map_or(Some(cell), |today| decay.applied(cell, today));
        let cells = self.supported(min_contributors);
        let cells: Vec<_> = cells.filter_map(|(index, cell)| Some((*index, worth(*cell)?))).collect();
        let mut observed = Box::new([0; VIEW_BLOCKS]);
        let mut support = Box::new([0; SUPPORT_BLOCKS]);
        for (index, _) in &cells {
            let (view, support_at) = (view_block(*index), support_block(*index));
            observed[view] = self.observed[view];
            support[support_at] = self.support[support_at];
        }
        Self { cells, observed, support, datum: self.datum }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{folded, hits, uploads};
    use super::*;
    use crate::evidence::{Pass, TileEvidence, presence};
    use proptest::prelude::*;
    use std::collections::{BTreeMap, BTreeSet};

    fn cell(last_day: u16) -> Cell {
        Cell {
            hits: 2,
            passes: 1,
            contributors: 1,
            presence: presence::ALWAYS,
            first_day: 20_000,
            last_day,
            ..Cell::default()
        }
    }

    proptest! {
        /// Fails when contributors are counted by pass or by upload.
        #[test]
        fn cells_are_served_where_enough_contributors_were(uploads in uploads(), least in 1..5_u8) {
            let (tile, _) = folded(&uploads);
            let mut near: BTreeMap<usize, BTreeSet<u64>> = BTreeMap::new();
            let mut own: BTreeMap<u32, BTreeSet<u64>> = BTreeMap::new();
            let mut passes: BTreeMap<usize, BTreeSet<Pass>> = BTreeMap::new();
            for (pass, evidence) in &uploads {
                for hit in &evidence.cells {
                    near.entry(support_block(hit.index)).or_default().insert(pass.contributor);
                    own.entry(hit.index).or_default().insert(pass.contributor);
                }
                for block in evidence.observed.iter() {
                    passes.entry(block).or_default().insert(*pass);
                }
            }
            let vouched = |index: u32| {
                let well_seen = passes.get(&view_block(index)).is_some_and(|p| p.len() >= 6);
                let alone = least > 1 && well_seen && own[&index].len() < 2;
                !alone && near[&support_block(index)].len() >= usize::from(least)
            };
            let served = tile.published(least, None, &Decay::default());
            let expected = tile.cells().iter().filter(|(index, _)| vouched(*index));
            prop_assert!(served.cells().iter().eq(expected));
            let is_served = |block: usize| served.cells().iter().any(|(index, _)| support_block(*index) == block);
            prop_assert!((0..SUPPORT_BLOCKS).all(|block| is_served(block) || served.support()[block] == 0));
            prop_assert_eq!(served.published(least, None, &Decay::default()), served);
        }
    }

    #[test]
    fn all_is_served_when_one_contributor_is_enough() {
        let evidence = TileEvidence::of_hits(hits(&[(3, 1), (90, 2)].into()));
        let (tile, _) = folded(&[(Pass { day: 20_000, contributor: 1 }, evidence)]);
        assert_eq!(tile.published(1, None, &Decay::default()), tile);
    }

    #[test]
    fn presence_is_halved_each_half_life_until_the_cell_expires() {
        let tile = Tile::from_cells(vec![(3, cell(20_000)), (4, cell(20_200))]).unwrap();
        let served = |today| {
            let served = tile.published(1, Some(today), &Decay::default());
            let evidence = |(index, cell): &(u32, Cell)| {
                (*index, (presence::fraction(cell.presence) * 1e4).round() / 1e4)
            };
            served.cells().iter().map(evidence).collect::<Vec<_>>()
        };
        assert_eq!(served(19_000), [(3, 1.0), (4, 1.0)], "a clock that is wrong does no harm");
        assert_eq!(served(20_180), [(3, 0.5), (4, 1.0)]);
        assert_eq!(served(20_360), [(3, 0.25), (4, 0.5400)]);
        assert_eq!(served(20_366), [(4, 0.5277)]);
        assert_eq!(served(u16::MAX), []);
    }
}
