//! Folding: an upload's evidence is added to a tile.

use super::ledger::{CellNews, News};
use super::{Ledger, Tile};
use crate::datum::{Offset, PoseSigma};
use crate::evidence::{Cell, CellHits, Pass, TileEvidence, presence, view_block};

impl Tile {
    /// Folds one upload's evidence in, as votes of `pass`; `ledger` is the tile's own.
    ///
    /// A cell in a block that the pass has in view for the first time, and does not hit, gets less
    /// present; one that fades altogether is dropped. Its cells must be in order of their
    /// index, as [`crate::evidence::EvidenceDelta`] holds them.
    pub fn fold(&mut self, ledger: &mut Ledger, pass: Pass, evidence: &TileEvidence) {
        self.fold_moved(ledger, pass, evidence, Offset::default(), PoseSigma::default());
    }

    /// The same with evidence that was moved onto the map, by `offset` at the tile's centre; its poses are known to
    /// `sigma`. A pass counts once in the datum, with its first upload.
    pub fn fold_moved(
        &mut self,
        ledger: &mut Ledger,
        pass: Pass,
        evidence: &TileEvidence,
        offset: Offset,
        sigma: PoseSigma,
    ) {
        if !ledger.knows(pass) {
            self.datum.add(offset, sigma);
        }
        let news = ledger.record(pass, evidence);
        for block in news.observed.iter() {
            self.observed[block] = self.observed[block].saturating_add(1);
        }
        for block in &news.supported {
            self.support[*block] = self.support[*block].saturating_add(1);
        }
        let mut merged = Vec::with_capacity(self.cells.len() + evidence.cells.len());
        let mut old = std::mem::take(&mut self.cells).into_iter().peekable();
        for (hit, cell_news) in evidence.cells.iter().zip(&news.cells) {
            while let Some((index, cell)) = old.next_if(|(index, _)| *index < hit.index) {
                merged.extend(self.passed_by(index, cell, &news));
            }
            let before = old.next_if(|(index, _)| *index == hit.index).map(|(_, cell)| cell);
            let mut cell = raised(before.unwrap_or_default(), pass.day, hit, *cell_news);
            cell.presence = self.presence_hit(hit.index, cell.presence, &news, *cell_news);
            merged.push((hit.index, cell));
        }
        merged.extend(old.filter_map(|(index, cell)| self.passed_by(index, cell, &news)));
        self.cells = merged;
    }

    /// A cell that the upload did not hit; `None` when it has faded.
    fn passed_by(&self, index: u32, cell: Cell, news: &News) -> Option<(u32, Cell)> {
        let block = view_block(index);
        if !news.observed.contains(block) {
            return Some((index, cell));
        }
        let observed = self.observed[block];
        let presence = presence::missed(cell.presence, observed);
        (!presence::is_faded(presence, observed)).then_some((index, Cell { presence, ..cell }))
    }

    /// Presence of a cell that the upload hit.
    fn presence_hit(&self, index: u32, before: u16, news: &News, cell_news: CellNews) -> u16 {
        let block = view_block(index);
        let observed = self.observed[block];
        if news.observed.contains(block) {
            presence::hit(before, observed)
        } else if cell_news.pass {
            presence::made_up(before, observed)
        } else {
            before
        }
    }
}

/// The cell after a hit, its presence aside. One that had faded starts again, whoever comes back.
fn raised(before: Cell, day: u16, hit: &CellHits, news: CellNews) -> Cell {
    let new = before.hits == 0;
    Cell {
        hits: before.hits.saturating_add(hit.hits),
        passes: before.passes.saturating_add(u32::from(news.pass)).max(1),
        contributors: before.contributors.saturating_add(u8::from(news.contributor)).max(1),
        presence: before.presence,
        first_day: if new { day } else { before.first_day.min(day) },
        last_day: before.last_day.max(day),
        offset_sum: [0, 1].map(|axis| before.offset_sum[axis].saturating_add(hit.offset_sum[axis])),
    }
}
