//! Who voted for which cell, while it matters.

use std::collections::{BTreeMap, BTreeSet};

use crate::evidence::Pass;

/// Days a pass stays open, counted back from the newest one.
const OPEN_DAYS: u16 = 30;
/// Votes one tile's ledger holds, at most: some megabytes.
const MAX_VOTES: usize = 500_000;

/// The cells each recent pass has voted for in one tile.
///
/// It is bounded: passes older than a month, and the oldest ones beyond half a million votes, are
/// closed. Should one of them vote again, it counts as another pass.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Ledger {
    votes: BTreeMap<Pass, BTreeSet<u32>>,
}

impl Ledger {
    /// Records a pass's votes and says for each cell, in order, whether it is that pass's first.
    pub(super) fn vote(&mut self, pass: Pass, cells: impl Iterator<Item = u32>) -> Vec<bool> {
        let voted = self.votes.entry(pass).or_default();
        let first_votes = cells.map(|cell| voted.insert(cell)).collect();
        self.close_oldest(MAX_VOTES);
        first_votes
    }

    /// Depends on the votes alone, so that folding again from nothing gives the same ledger.
    fn close_oldest(&mut self, max_votes: usize) {
        if let Some((newest, _)) = self.votes.last_key_value() {
            self.forget_before(newest.day.saturating_sub(OPEN_DAYS));
        }
        let mut votes: usize = self.votes.values().map(BTreeSet::len).sum();
        while votes > max_votes
            && let Some((_, closed)) = self.votes.pop_first()
        {
            votes -= closed.len();
        }
    }

    /// Forgets passes of days before `day`: their uploads are no longer accepted, so they cannot
    /// vote again.
    pub fn forget_before(&mut self, day: u16) {
        self.votes = self.votes.split_off(&Pass { day, contributor: 0 });
    }

    /// Passes and their cells, in order.
    pub fn iter(&self) -> impl Iterator<Item = (Pass, &BTreeSet<u32>)> {
        self.votes.iter().map(|(pass, cells)| (*pass, cells))
    }

    /// True when no pass can vote twice.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.votes.is_empty()
    }
}

impl FromIterator<(Pass, BTreeSet<u32>)> for Ledger {
    fn from_iter<I: IntoIterator<Item = (Pass, BTreeSet<u32>)>>(iter: I) -> Self {
        Self { votes: iter.into_iter().collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ledger_is_bounded_in_days_and_votes() {
        let mut ledger = Ledger::default();
        for day in 0..100 {
            ledger.vote(Pass { day, contributor: 1 }, 0..10);
        }
        assert_eq!(ledger.iter().count(), usize::from(OPEN_DAYS) + 1);
        ledger.close_oldest(25);
        let left: Vec<_> = ledger.iter().map(|(pass, _)| pass.day).collect();
        assert_eq!(left, [98, 99]);
    }

    #[test]
    fn old_passes_are_forgotten_and_the_rest_kept() {
        let mut ledger = Ledger::default();
        for day in 10..13 {
            ledger.vote(Pass { day, contributor: 7 }, [1, 2].into_iter());
        }
        ledger.forget_before(12);
        let left: Vec<_> = ledger.iter().map(|(pass, _)| pass.day).collect();
        assert_eq!(left, [12]);
        assert_eq!(ledger.vote(Pass { day: 12, contributor: 7 }, [2, 3].into_iter()), [false, true]);
    }
}
