//! Who voted for which cell and had what in view, while it matters.

use std::collections::{BTreeMap, BTreeSet};

use super::CELLS;
use super::votes::EncodedVotes;
use crate::evidence::{Pass, SUPPORT_BLOCKS, TileEvidence, ViewBlocks, support_block, view_block};

/// Days a pass stays open, counted back from the newest one.
const OPEN_DAYS: u16 = 30;
/// Votes one tile's ledger holds, at most: some megabytes.
pub(super) const MAX_VOTES: usize = 500_000;
/// Votes that a pass's blocks in view count for.
const OBSERVED_VOTES: usize = 32;

/// What the open passes have said of one tile.
///
/// It is bounded: passes older than a month, and the oldest ones beyond half a million votes, are
/// closed. Should one of them vote again, it counts as another pass, and its contributor as another
/// one unless a later pass of the same contributor is open.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Ledger {
    passes: BTreeMap<Pass, EncodedVotes>,
}

/// What is new in an upload's evidence.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct News {
    /// Of each cell, in order.
    pub(super) cells: Vec<CellNews>,
    /// Blocks the pass had not had in view yet.
    pub(super) observed: ViewBlocks,
    /// Support blocks in which no open pass of the contributor had a hit yet.
    pub(super) supported: Vec<usize>,
}

/// What is new about a hit of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct CellNews {
    /// The pass had not voted for it yet.
    pub(super) pass: bool,
    /// No open pass of the contributor had.
    pub(super) contributor: bool,
}

impl Ledger {
    /// Records what an upload of a pass says of the tile, and returns what is new in it.
    pub(super) fn record(&mut self, pass: Pass, evidence: &TileEvidence) -> News {
        let mut known = Known::of(self, pass.contributor);
        let mut votes = self.passes.get(&pass).map(EncodedVotes::votes).unwrap_or_default();
        let cells = evidence.cells.iter().map(|hit| CellNews {
            pass: votes.cells.binary_search(&hit.index).is_err(),
            contributor: known.cells.insert(hit.index as usize),
        });
        let cells: Vec<_> = cells.collect();
        let blocks = evidence.cells.iter().map(|hit| support_block(hit.index));
        let supported = blocks.filter(|block| known.blocks.insert(*block)).collect();
        let hit: ViewBlocks = evidence.cells.iter().map(|hit| view_block(hit.index)).collect();
        let in_view = evidence.observed.union(&hit);
        let observed = in_view.without(&votes.observed);
        votes.observed = votes.observed.union(&in_view);
        let new = evidence.cells.iter().zip(&cells).filter(|(_, news)| news.pass).map(|(hit, _)| hit.index);
        votes.cells.extend(new);
        votes.cells.sort_unstable();
        self.passes.insert(pass, EncodedVotes::of(&votes));
        self.close_oldest(MAX_VOTES);
        News { cells, observed, supported }
    }

    /// Has the pass said something already?
    #[must_use]
    pub fn knows(&self, pass: Pass) -> bool {
        self.passes.contains_key(&pass)
    }

    /// Depends on the votes alone, so that folding again from nothing gives the same ledger.
    fn close_oldest(&mut self, max_votes: usize) {
        if let Some((newest, _)) = self.passes.last_key_value() {
            self.forget_before(newest.day.saturating_sub(OPEN_DAYS));
        }
        let mut held: usize = self.passes.values().map(Self::weight).sum();
        while held > max_votes
            && let Some((_, closed)) = self.passes.pop_first()
        {
            held -= Self::weight(&closed);
        }
    }

    /// What a pass counts for against the most votes that a ledger holds.
    pub(super) fn weight(votes: &EncodedVotes) -> usize {
        votes.cells() + OBSERVED_VOTES
    }

    /// Forgets passes of days before `day`: their uploads are no longer accepted, so they cannot
    /// vote again.
    pub fn forget_before(&mut self, day: u16) {
        self.passes = self.passes.split_off(&Pass { day, contributor: 0 });
    }

    /// The passes, in order.
    pub fn passes(&self) -> impl Iterator<Item = Pass> {
        self.passes.keys().copied()
    }

    /// The contributors whose open passes hit a cell, in order of their hashes.
    #[must_use]
    pub fn contributors_of(&self, cell: u32) -> Vec<u64> {
        let hit = |votes: &EncodedVotes| votes.votes().cells.binary_search(&cell).is_ok();
        let who = self.iter().filter(|(_, votes)| hit(votes)).map(|(pass, _)| pass.contributor);
        who.collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// Passes and what they said, in order.
    pub(super) fn iter(&self) -> impl Iterator<Item = (Pass, &EncodedVotes)> {
        self.passes.iter().map(|(pass, votes)| (*pass, votes))
    }

    /// True when no pass can vote twice.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.passes.is_empty()
    }
}

impl FromIterator<(Pass, EncodedVotes)> for Ledger {
    fn from_iter<I: IntoIterator<Item = (Pass, EncodedVotes)>>(iter: I) -> Self {
        Self { passes: iter.into_iter().collect() }
    }
}

/// What a contributor's open passes have hit.
struct Known {
    cells: Bits,
    blocks: Bits,
}

impl Known {
    fn of(ledger: &Ledger, contributor: u64) -> Self {
        let mut known = Self { cells: Bits::new(CELLS as usize), blocks: Bits::new(SUPPORT_BLOCKS) };
        for (_, votes) in ledger.iter().filter(|(pass, _)| pass.contributor == contributor) {
            for cell in votes.votes().cells {
                known.cells.insert(cell as usize);
                known.blocks.insert(support_block(cell));
            }
        }
        known
    }
}

/// A set of small numbers.
struct Bits {
    words: Vec<u64>,
}

impl Bits {
    fn new(limit: usize) -> Self {
        Self { words: vec![0; limit.div_ceil(64)] }
    }

    /// Adds a number below the limit; true when it was not there yet.
    fn insert(&mut self, value: usize) -> bool {
        let (word, bit) = (&mut self.words[value / 64], 1 << (value % 64));
        let new = *word & bit == 0;
        *word |= bit;
        new
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::hits;
    use super::*;

    fn evidence(cells: impl IntoIterator<Item = u32>) -> TileEvidence {
        TileEvidence::of_hits(hits(&cells.into_iter().map(|index| (index, 1)).collect()))
    }

    /// What is new about cells, as (pass, contributor).
    fn new_cells(news: &News) -> Vec<(bool, bool)> {
        news.cells.iter().map(|cell| (cell.pass, cell.contributor)).collect()
    }

    #[test]
    fn the_ledger_is_bounded_in_days_and_votes() {
        let mut ledger = Ledger::default();
        for day in 0..100 {
            ledger.record(Pass { day, contributor: 1 }, &evidence(0..10));
        }
        assert_eq!(ledger.passes().count(), usize::from(OPEN_DAYS) + 1);
        ledger.close_oldest(2 * (10 + OBSERVED_VOTES) + 1);
        let left: Vec<_> = ledger.passes().map(|pass| pass.day).collect();
        assert_eq!(left, [98, 99]);
    }

    #[test]
    fn old_passes_are_forgotten_and_the_rest_kept() {
        let mut ledger = Ledger::default();
        for day in 10..13 {
            ledger.record(Pass { day, contributor: 7 }, &evidence([1, 2]));
        }
        ledger.forget_before(12);
        let left: Vec<_> = ledger.passes().map(|pass| pass.day).collect();
        assert_eq!(left, [12]);
        let news = ledger.record(Pass { day: 12, contributor: 7 }, &evidence([2, 3]));
        assert_eq!(new_cells(&news), [(false, false), (true, true)]);
    }

    /// Fails when contributors are distinguished by their passes.
    #[test]
    fn a_contributor_is_new_once_while_a_pass_of_it_is_open() {
        let mut ledger = Ledger::default();
        let mut record = |day, contributor, cells: &[u32]| {
            ledger.record(Pass { day, contributor }, &evidence(cells.iter().copied()))
        };
        let first = record(10, 1, &[0, 5]);
        assert_eq!((new_cells(&first), first.supported), (vec![(true, true); 2], vec![0, 1]));
        let again = record(11, 1, &[0, 1, 10]);
        assert_eq!(new_cells(&again), [(true, false), (true, true), (true, true)]);
        assert_eq!(again.supported, [2], "cell 1 shares a block with cell 0");
        let other = record(11, 2, &[0]);
        assert_eq!((new_cells(&other), other.supported), (vec![(true, true)], vec![0]));
        let later = record(60, 1, &[0]);
        assert_eq!((new_cells(&later), later.supported), (vec![(true, false)], vec![]), "closed by this one");
        let last = record(95, 2, &[0]);
        assert_eq!((new_cells(&last), last.supported), (vec![(true, true)], vec![0]), "closed long ago");
    }

    /// Catches: a contributor that is named twice, or where it hit nothing.
    #[test]
    fn who_hit_a_cell_is_known_while_the_passes_are_open() {
        let mut ledger = Ledger::default();
        for (day, contributor, cells) in [(10, 7, 0..3), (11, 7, 2..4), (11, 5, 2..3)] {
            ledger.record(Pass { day, contributor }, &evidence(cells));
        }
        assert_eq!(
            [0, 2, 3, 4].map(|cell| ledger.contributors_of(cell)),
            [vec![7], vec![5, 7], vec![7], vec![]]
        );
    }

    #[test]
    fn blocks_are_observed_once_a_pass_and_those_hit_always_are() {
        let mut ledger = Ledger::default();
        let pass = Pass { day: 10, contributor: 1 };
        let mut seen = evidence([0]);
        seen.observed = [5].into_iter().collect();
        let observed = |news: News| news.observed.iter().collect::<Vec<_>>();
        assert_eq!(observed(ledger.record(pass, &seen)), [0, 5]);
        seen.observed = [5, 6].into_iter().collect();
        assert_eq!(observed(ledger.record(pass, &seen)), [6]);
        assert_eq!(observed(ledger.record(Pass { day: 11, ..pass }, &seen)), [0, 5, 6]);
    }
}
