//! What the index holds, between two changes.

use std::collections::{BTreeMap, HashMap, HashSet};

use echofix_core::geo::TileId;
use uuid::Uuid;

use crate::store::log::entry::{Action, Control, RecordKind};
use crate::store::log::exclusion::Exclusion;
use crate::store::log::position::{RecordPosition, Written};

/// Bytes of records handed out for folding at a time, but for a single larger one.
const FOLD_BYTES: u64 = 8 << 20;
/// Records handed out for folding at a time: the map shows them once all are folded.
const FOLD_RECORDS: usize = 64;

#[derive(Default)]
pub(super) struct IndexState {
    /// Number by upload id.
    pub(super) numbers: HashMap<Uuid, u64>,
    pub(super) imports: HashMap<(Uuid, TileId), u64>,
    pub(super) controls: BTreeMap<u64, Control>,
    /// Files that records are tiles of.
    pub(super) files: BTreeMap<u64, Uuid>,
    /// Number of the record before the first.
    pub(super) before: u64,
    /// In order of their numbers, and so are the runs they come in.
    pub(super) records: Vec<IndexEntry>,
    pub(super) runs: Vec<DayRun>,
    /// Uploads being written.
    pub(super) pending: HashSet<Uuid>,
    pub(super) ended: bool,
}

/// A record in the journal, without what its run, the controls and the files say of it.
#[derive(Clone, Copy)]
pub(super) struct IndexEntry {
    pub(super) offset: u32,
    pub(super) length: u32,
    /// Of an upload.
    pub(super) contributor: u64,
}

/// Records of one segment that were written on one day.
pub(super) struct DayRun {
    /// Number of the first of them.
    pub(super) first: u64,
    pub(super) segment: u64,
    /// UTC day.
    pub(super) day: u16,
}

impl IndexState {
    /// What these controls exclude, all of which are in effect.
    pub(super) fn excluded_by(&self, controls: &[(u64, Action)]) -> Exclusion {
        let mut exclusion = Exclusion::default();
        for (number, action) in controls {
            exclusion.add(*number, *action, |id| self.numbers.get(&id).copied());
        }
        exclusion
    }

    pub(super) fn newest(&self) -> u64 {
        self.before + self.records.len() as u64
    }

    pub(super) fn find(&self, id: Uuid) -> Option<Written> {
        let number = *self.numbers.get(&id)?;
        Some(Written { number, at: self.at(number)? })
    }

    pub(super) fn get(&self, number: u64) -> Option<&IndexEntry> {
        self.records.get(number.checked_sub(self.before + 1)? as usize)
    }

    pub(super) fn at(&self, number: u64) -> Option<RecordPosition> {
        let IndexEntry { offset, length, .. } = *self.get(number)?;
        Some(RecordPosition { segment: self.run(number).segment, offset, length })
    }

    pub(super) fn kind(&self, number: u64) -> Option<RecordKind> {
        let contributor = self.get(number)?.contributor;
        if self.controls.contains_key(&number) {
            return Some(RecordKind::Control);
        }
        let import = self.files.get(&number).map(|file| RecordKind::Import { file: *file });
        import.or(Some(RecordKind::Upload { contributor }))
    }

    pub(super) fn kinds(&self) -> impl Iterator<Item = (u64, RecordKind)> {
        (self.before + 1..).map_while(|number| Some((number, self.kind(number)?)))
    }

    /// The run of a record that was noted.
    pub(super) fn run(&self, number: u64) -> &DayRun {
        &self.runs[self.runs.partition_point(|run| run.first <= number) - 1]
    }

    pub(super) fn group(&self, after: u64, last: u64) -> Vec<Written> {
        let mut bytes = 0;
        let numbers = after.max(self.before) + 1..=last;
        let next = numbers.map_while(|number| Some(Written { number, at: self.at(number)? }));
        let group = next.take_while(|written| {
            let fits = bytes < FOLD_BYTES;
            bytes += u64::from(written.at.length);
            fits
        });
        group.take(FOLD_RECORDS).collect()
    }
}
