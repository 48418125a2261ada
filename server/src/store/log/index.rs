//! Which records the journal holds, where they lie, and what of them counts.
//!
//! It stays in memory for as long as the records stay in the journal, since a vehicle may send an upload again: 16
//! bytes an upload, and 29 to 57 for its id, by how full the table is. What the records of a segment have in common is stored
//! once for all of them.

mod state;

use std::collections::{BTreeSet, HashMap};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use echofix_core::geo::TileId;
use uuid::Uuid;

use super::entry::{Action, Control, RecordKind, RecordMeta, RecordSubject};
use super::exclusion::{Exclusion, in_effect};
use super::position::{RecordPosition, Written};
use state::{DayRun, IndexEntry, IndexState};

/// What the journal holds, in memory.
#[derive(Default)]
pub(in crate::store) struct JournalIndex {
    state: Mutex<IndexState>,
    /// A record was written or given up, or the end was called.
    changed: Condvar,
}

/// What folding does next.
#[derive(Debug)]
pub(in crate::store) enum NextFold {
    /// Fold these.
    Records(Vec<Written>),
    /// A control was written: a new generation is needed.
    Build,
}

/// The answer to a request for the right to write an upload.
pub(in crate::store) enum Reserved<'a> {
    /// It is in the journal already.
    Counted(Written),
    /// The caller may write it while it holds this.
    New(Reservation<'a>),
}

/// The right to write an upload; others with the same id wait for its end.
pub(in crate::store) struct Reservation<'a> {
    index: &'a JournalIndex,
    id: Uuid,
}

impl Drop for Reservation<'_> {
    fn drop(&mut self) {
        self.index.lock().pending.remove(&self.id);
        self.index.changed.notify_all();
    }
}

impl JournalIndex {
    /// Asks for the right to write an upload, waiting while another caller writes the same.
    pub(in crate::store) fn reserve(&self, id: Uuid) -> Reserved<'_> {
        let mut state = self.lock();
        loop {
            if let Some(written) = state.find(id) {
                return Reserved::Counted(written);
            }
            if state.pending.insert(id) {
                return Reserved::New(Reservation { index: self, id });
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// An upload that was counted.
    pub(in crate::store) fn find(&self, id: Uuid) -> Option<Written> {
        self.lock().find(id)
    }

    /// Is this tile of an imported file in the journal?
    pub(in crate::store) fn imported(&self, file: Uuid, tile: TileId) -> bool {
        self.lock().imports.contains_key(&(file, tile))
    }

    /// Number, UTC day and contributor of an upload in the journal.
    pub(in crate::store) fn upload(&self, id: Uuid) -> Option<(u64, u16, u64)> {
        let state = self.lock();
        let number = *state.numbers.get(&id)?;
        let contributor = state.get(number)?.contributor;
        Some((number, state.run(number).day, contributor))
    }

    /// An imported tile in the journal.
    pub(in crate::store) fn find_import(&self, file: Uuid, tile: TileId) -> Option<Written> {
        let state = self.lock();
        let number = *state.imports.get(&(file, tile))?;
        Some(Written { number, at: state.at(number)? })
    }

    /// A record of the journal.
    pub(in crate::store) fn get(&self, number: u64) -> Option<Written> {
        Some(Written { number, at: self.lock().at(number)? })
    }

    /// Is anything of a kind in the journal after a number?
    pub(in crate::store) fn any_after(&self, number: u64, kind: RecordKind) -> bool {
        let state = self.lock();
        (number + 1..=state.newest()).any(|at| state.kind(at) == Some(kind))
    }

    /// The number before that of the first record of a journal without any.
    pub(in crate::store) fn begin_after(&self, number: u64) {
        let mut state = self.lock();
        if state.records.is_empty() {
            state.before = number;
        }
    }

    /// Notes a record that is in the journal. They come in order of their numbers.
    pub(in crate::store) fn insert(&self, meta: &RecordMeta, written: Written) {
        let mut state = self.lock();
        if state.records.is_empty() {
            state.before = written.number - 1;
        }
        debug_assert_eq!(written.number, state.newest() + 1);
        let Written { number, at: RecordPosition { segment, offset, length } } = written;
        let mut entry = IndexEntry { offset, length, contributor: 0 };
        match &meta.what {
            &RecordSubject::Upload { id, contributor } => {
                state.numbers.insert(id, number);
                entry.contributor = contributor;
            }
            &RecordSubject::Import { file, tile } => {
                state.imports.insert((file, tile), number);
                state.files.insert(number, file);
            }
            RecordSubject::Control(control) => {
                state.controls.insert(number, control.clone());
            }
        }
        if state.runs.last().is_none_or(|run| (run.segment, run.day) != (segment, meta.day)) {
            state.runs.push(DayRun { first: number, segment, day: meta.day });
        }
        state.records.push(entry);
        self.changed.notify_all();
    }

    /// Number of the newest record.
    pub(in crate::store) fn newest(&self) -> u64 {
        self.lock().newest()
    }

    /// Where the newest record lies.
    pub(in crate::store) fn newest_at(&self) -> Option<RecordPosition> {
        let state = self.lock();
        state.at(state.newest())
    }

    /// Number of the record before the first.
    pub(in crate::store) fn before(&self) -> u64 {
        self.lock().before
    }

    /// Uploads in the journal.
    pub(in crate::store) fn uploads(&self) -> u64 {
        self.lock().numbers.len() as u64
    }

    /// Uploads among the records after one, up to another.
    pub(in crate::store) fn uploads_within(&self, after: u64, last: u64) -> u64 {
        self.lock().numbers.values().filter(|number| (after + 1..=last).contains(number)).count() as u64
    }

    /// Number of the newest control; 0 without any.
    pub(in crate::store) fn newest_control(&self) -> u64 {
        self.lock().controls.last_key_value().map_or(0, |(number, _)| *number)
    }

    /// Number of the first control after a number.
    pub(in crate::store) fn control_after(&self, number: u64) -> Option<u64> {
        self.lock().controls.range(number + 1..).next().map(|(number, _)| *number)
    }

    /// The controls, in order.
    pub(in crate::store) fn controls(&self) -> Vec<(u64, Control)> {
        self.lock().controls.iter().map(|(number, control)| (*number, control.clone())).collect()
    }

    /// Controls that compact more than the ones before them and the checkpoint did: their numbers and the
    /// last record each of them compacts.
    pub(in crate::store) fn compactions_beyond(&self, mut checkpoint: u64) -> Vec<(u64, u64)> {
        let mut compactions = Vec::new();
        for (number, control) in self.controls() {
            if let Action::Compact(last) = control.action
                && last > checkpoint
            {
                compactions.push((number, last));
                checkpoint = last;
            }
        }
        compactions
    }

    /// The last record that is compacted or about to be; 0 for none.
    pub(in crate::store) fn compacted(&self) -> u64 {
        self.compactions_beyond(0).last().map_or(0, |(_, last)| *last)
    }

    /// What the controls up to this one, with it, exclude.
    pub(in crate::store) fn exclusion(&self, up_to_control: u64) -> Exclusion {
        let state = self.lock();
        state.excluded_by(&in_effect(&state.controls, up_to_control))
    }

    /// Is anything up to a number excluded now that was not when it was the newest?
    pub(in crate::store) fn excluded_since(&self, number: u64) -> bool {
        let state = self.lock();
        let by = |up_to| state.excluded_by(&in_effect(&state.controls, up_to));
        let (then, now) = (by(number), by(u64::MAX));
        let mut records = state.kinds().take_while(|(at, _)| *at <= number);
        records.any(|(at, kind)| now.excludes(at, kind) && !then.excludes(at, kind))
    }

    /// What all controls and one more, which is only thought of, exclude.
    pub(in crate::store) fn exclusion_with(&self, proposed: Control) -> Exclusion {
        let state = self.lock();
        let mut controls = state.controls.clone();
        controls.insert(state.newest() + 1, proposed);
        state.excluded_by(&in_effect(&controls, u64::MAX))
    }

    /// The control of a number, and whether it is in effect.
    pub(in crate::store) fn control(&self, number: u64) -> Option<(Control, bool)> {
        let state = self.lock();
        let control = state.controls.get(&number)?.clone();
        let effective = in_effect(&state.controls, u64::MAX).iter().any(|(at, _)| *at == number);
        Some((control, effective))
    }

    /// Which control undoes which, for those that are undone.
    pub(in crate::store) fn undone(&self) -> HashMap<u64, u64> {
        let state = self.lock();
        let undone = |(number, action)| match action {
            Action::Undo(earlier) => Some((earlier, number)),
            _ => None,
        };
        in_effect(&state.controls, u64::MAX).into_iter().filter_map(undone).collect()
    }

    /// The ids of the uploads that are these records.
    pub(in crate::store) fn ids(&self, numbers: &BTreeSet<u64>) -> HashMap<u64, Uuid> {
        let state = self.lock();
        let asked = state.numbers.iter().filter(|(_, number)| numbers.contains(number));
        asked.map(|(id, number)| (*number, *id)).collect()
    }

    /// How many uploads and imported tiles this control alone excludes.
    pub(in crate::store) fn effect(&self, number: u64, action: Action) -> u64 {
        let state = self.lock();
        // An undoing gives back what the other took.
        let of = std::iter::successors(Some((number, action)), |(_, action)| match action {
            Action::Undo(earlier) => Some((*earlier, state.controls.get(earlier)?.action)),
            _ => None,
        });
        let Some(of) = of.last() else { return 0 };
        let exclusion = state.excluded_by(&[of]);
        state.kinds().filter(|(number, kind)| exclusion.excludes(*number, *kind)).count() as u64
    }

    /// The last record before which, with it, all were written before a day, and whose segment ends
    /// with it: the segments up to it can go. `None` when there is no such record.
    pub(in crate::store) fn last_before(&self, day: u16) -> Option<u64> {
        let state = self.lock();
        // A clock that was set back leaves days of no order: the cut is made before the first segment of that day or a later one, which
        // is named by its first record.
        let young = state.runs.iter().find(|run| run.day >= day);
        let last = young.map_or(state.newest(), |run| run.segment - 1);
        (last > state.before).then_some(last)
    }

    /// The next records after a number and up to another, as many as are folded at a time.
    pub(in crate::store) fn records(&self, after: u64, last: u64) -> Vec<Written> {
        self.lock().group(after, last)
    }

    /// Which of these records an exclusion leaves.
    pub(in crate::store) fn counted(&self, group: &[Written], exclusion: &Exclusion) -> Vec<Written> {
        let state = self.lock();
        let counts = |written: &&Written| {
            let kind = state.kind(written.number);
            kind.is_some_and(|kind| !exclusion.excludes(written.number, kind))
        };
        group.iter().filter(counts).copied().collect()
    }

    /// What folding does next after a record, under the controls up to one; waits until there is
    /// something to do. `None` at the end.
    pub(in crate::store) fn next(&self, folded: u64, applied: u64) -> Option<NextFold> {
        let mut state = self.lock();
        loop {
            if state.ended {
                return None;
            }
            if state.controls.range(applied + 1..).next().is_some() {
                return Some(NextFold::Build);
            }
            if state.newest() > folded {
                let last = state.newest();
                return Some(NextFold::Records(state.group(folded, last)));
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Visits the records, oldest first: their numbers, days and kinds.
    pub(in crate::store) fn visit(&self, mut each: impl FnMut(u64, u16, RecordKind)) {
        let state = self.lock();
        for (number, kind) in state.kinds() {
            each(number, state.run(number).day, kind);
        }
    }

    /// Forgets the records up to this one: they are in the checkpoint, and their segments go.
    pub(in crate::store) fn truncate(&self, last: u64) {
        let mut state = self.lock();
        let gone = last.saturating_sub(state.before).min(state.records.len() as u64);
        state.before += gone;
        let before = state.before;
        let runs = state.runs.partition_point(|run| run.first <= before + 1).saturating_sub(1);
        state.runs.drain(..runs);
        state.records.drain(..gone as usize);
        state.numbers.retain(|_, number| *number > before);
        state.imports.retain(|_, number| *number > before);
        state.controls.retain(|number, _| *number > before);
        state.files.retain(|number, _| *number > before);
        state.records.shrink_to_fit();
        state.numbers.shrink_to_fit();
    }

    /// Waits, but not beyond the end; false at the end.
    pub(in crate::store) fn pause(&self, time: Duration) -> bool {
        let (state, _) = self
            .changed
            .wait_timeout_while(self.lock(), time, |state| !state.ended)
            .unwrap_or_else(PoisonError::into_inner);
        !state.ended
    }

    /// Was the end called?
    pub(in crate::store) fn ended(&self) -> bool {
        self.lock().ended
    }

    /// Wakes the threads that wait in [`JournalIndex::next`] for the last time.
    pub(in crate::store) fn end(&self) {
        self.lock().ended = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, IndexState> {
        // Every change is made in one step: a panic elsewhere leaves the state whole.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
