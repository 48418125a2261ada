//! Which records the journal holds, where they lie, and what of them counts.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::RangeInclusive;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use echofix_core::geo::TileId;
use uuid::Uuid;

use super::entry::{Action, Control, Kind, Note, What};
use super::exclusion::Exclusion;
use super::journal::{Position, Written};

/// Bytes of records handed out for folding at a time, but for a single larger one.
const FOLD_BYTES: u64 = 8 << 20;
/// Records handed out for folding at a time: the map shows them once all are folded.
const FOLD_RECORDS: usize = 64;

/// What the journal holds, in memory.
#[derive(Default)]
pub(super) struct Index {
    state: Mutex<State>,
    /// A record was written or given up, or the end was called.
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Number by upload id.
    numbers: HashMap<Uuid, u64>,
    imports: HashMap<(Uuid, TileId), u64>,
    controls: BTreeMap<u64, Control>,
    /// Number of the record before the first.
    before: u64,
    /// In order of their numbers.
    records: Vec<Noted>,
    uploads: u64,
    /// Uploads being written.
    pending: HashSet<Uuid>,
    ended: bool,
}

/// A record in the journal.
#[derive(Debug, Clone)]
pub(super) struct Noted {
    at: Position,
    /// UTC day it was written on.
    pub(super) day: u16,
    pub(super) kind: Kind,
}

/// What folding does next.
#[derive(Debug)]
pub(super) enum Next {
    /// Fold these.
    Records(Vec<Written>),
    /// A control was written: a new generation is needed.
    Build,
}

/// Who may write an upload.
pub(super) enum Claim<'a> {
    /// Nobody: it is in the journal.
    Counted(Written),
    /// The caller, while it holds this.
    Ours(Pending<'a>),
}

/// The right to write an upload; others with the same id wait for its end.
pub(super) struct Pending<'a> {
    index: &'a Index,
    id: Uuid,
}

impl Drop for Pending<'_> {
    fn drop(&mut self) {
        self.index.lock().pending.remove(&self.id);
        self.index.changed.notify_all();
    }
}

impl Index {
    /// Asks for the right to write an upload, waiting while another caller writes the same.
    pub(super) fn claim(&self, id: Uuid) -> Claim<'_> {
        let mut state = self.lock();
        loop {
            if let Some(written) = state.find(id) {
                return Claim::Counted(written);
            }
            if state.pending.insert(id) {
                return Claim::Ours(Pending { index: self, id });
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// An upload that was counted.
    pub(super) fn find(&self, id: Uuid) -> Option<Written> {
        self.lock().find(id)
    }

    /// Is this tile of an imported file in the journal?
    pub(super) fn imported(&self, file: Uuid, tile: TileId) -> bool {
        self.lock().imports.contains_key(&(file, tile))
    }

    /// Is anything of a kind in the journal after a number?
    pub(super) fn any_after(&self, number: u64, kind: Kind) -> bool {
        self.lock().numbered().any(|(at, noted)| at > number && noted.kind == kind)
    }

    /// A journal without records goes on after this number.
    pub(super) fn begin_after(&self, number: u64) {
        let mut state = self.lock();
        if state.records.is_empty() {
            state.before = number;
        }
    }

    /// Notes a record that is in the journal. They come in order of their numbers.
    pub(super) fn note(&self, note: &Note, written: Written) {
        let mut state = self.lock();
        if state.records.is_empty() {
            state.before = written.number - 1;
        }
        debug_assert_eq!(written.number, state.newest() + 1);
        let kind = match note.what {
            What::Upload { id, contributor } => {
                state.numbers.insert(id, written.number);
                state.uploads += 1;
                Kind::Upload { contributor }
            }
            What::Import { file, tile } => {
                state.imports.insert((file, tile), written.number);
                Kind::Import { file }
            }
            What::Control(control) => {
                state.controls.insert(written.number, control);
                Kind::Control
            }
        };
        state.records.push(Noted { at: written.at, day: note.day, kind });
        self.changed.notify_all();
    }

    /// Number of the newest record.
    pub(super) fn newest(&self) -> u64 {
        self.lock().newest()
    }

    /// Where the newest record lies.
    pub(super) fn newest_at(&self) -> Option<Position> {
        self.lock().records.last().map(|noted| noted.at)
    }

    /// Number of the record before the first.
    pub(super) fn before(&self) -> u64 {
        self.lock().before
    }

    /// Day the newest record was written on.
    pub(super) fn newest_day(&self) -> Option<u16> {
        self.lock().records.last().map(|noted| noted.day)
    }

    /// Uploads in the journal.
    pub(super) fn uploads(&self) -> u64 {
        self.lock().uploads
    }

    /// Uploads among the records up to a number.
    pub(super) fn uploads_up_to(&self, last: u64) -> u64 {
        let state = self.lock();
        let records = state.numbered().take_while(|(number, _)| *number <= last);
        records.filter(|(_, noted)| matches!(noted.kind, Kind::Upload { .. })).count() as u64
    }

    /// Number of the newest control; 0 without any.
    pub(super) fn newest_control(&self) -> u64 {
        self.lock().controls.last_key_value().map_or(0, |(number, _)| *number)
    }

    /// Number of the first control after a number.
    pub(super) fn control_after(&self, number: u64) -> Option<u64> {
        self.lock().controls.range(number + 1..).next().map(|(number, _)| *number)
    }

    /// The controls, in order.
    pub(super) fn controls(&self) -> Vec<(u64, Control)> {
        self.lock().controls.iter().map(|(number, control)| (*number, *control)).collect()
    }

    /// Controls that settle more than the ones before them and the base did: their numbers and the
    /// last record each of them settles.
    pub(super) fn settles_beyond(&self, mut base: u64) -> Vec<(u64, u64)> {
        let mut settles = Vec::new();
        for (number, control) in self.controls() {
            if let Action::Settle(last) = control.action
                && last > base
            {
                settles.push((number, last));
                base = last;
            }
        }
        settles
    }

    /// The last record that is settled or about to be; 0 for none.
    pub(super) fn settled(&self) -> u64 {
        self.settles_beyond(0).last().map_or(0, |(_, last)| *last)
    }

    /// What the controls up to this one, with it, exclude.
    pub(super) fn exclusion(&self, up_to_control: u64) -> Exclusion {
        let state = self.lock();
        let mut exclusion = Exclusion::default();
        for (number, control) in state.controls.range(..=up_to_control) {
            exclusion.add(*number, control.action, |id| state.numbers.get(&id).copied());
        }
        exclusion
    }

    /// How many uploads and imported tiles this control alone excludes.
    pub(super) fn effect(&self, number: u64, action: Action) -> u64 {
        let state = self.lock();
        let mut exclusion = Exclusion::default();
        exclusion.add(number, action, |id| state.numbers.get(&id).copied());
        state.numbered().filter(|(number, noted)| exclusion.excludes(*number, noted.kind)).count() as u64
    }

    /// The last record before which, with it, all were written before a day, and whose segment ends
    /// with it: the segments up to it can go. `None` when there is no such record.
    pub(super) fn last_before(&self, day: u16) -> Option<u64> {
        let state = self.lock();
        let mut old = state.records.iter().take_while(|noted| noted.day < day).count();
        // A clock that was set back leaves days of no order: then the cut is made before the segment.
        if let Some(next) = state.records.get(old) {
            old = old.min(state.records.partition_point(|noted| noted.at.segment < next.at.segment));
        }
        (old > 0).then_some(state.before + old as u64)
    }

    /// The next records after a number and up to another, as many as are folded at a time.
    pub(super) fn records(&self, after: u64, last: u64) -> Vec<Written> {
        self.lock().group(after, last)
    }

    /// Which of these records an exclusion leaves.
    pub(super) fn counted(&self, group: &[Written], exclusion: &Exclusion) -> Vec<Written> {
        let state = self.lock();
        let counts = |written: &&Written| {
            let noted = state.get(written.number);
            noted.is_some_and(|noted| !exclusion.excludes(written.number, noted.kind))
        };
        group.iter().filter(counts).copied().collect()
    }

    /// What folding does next after a record, under the controls up to one; waits until there is
    /// something to do. `None` at the end.
    pub(super) fn next(&self, folded: u64, applied: u64) -> Option<Next> {
        let mut state = self.lock();
        loop {
            if state.ended {
                return None;
            }
            if state.controls.range(applied + 1..).next().is_some() {
                return Some(Next::Build);
            }
            if state.newest() > folded {
                let last = state.newest();
                return Some(Next::Records(state.group(folded, last)));
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Visits the records, oldest first.
    pub(super) fn visit(&self, range: RangeInclusive<u64>, mut each: impl FnMut(u64, &Noted)) {
        let state = self.lock();
        let inside = state.numbered().filter(|(number, _)| range.contains(number));
        inside.for_each(|(number, noted)| each(number, noted));
    }

    /// Forgets the records up to this one: they are in the base, and their segments go.
    pub(super) fn forget_up_to(&self, last: u64) {
        let mut state = self.lock();
        let gone = last.saturating_sub(state.before).min(state.records.len() as u64);
        let forgotten = state.records.drain(..gone as usize);
        let uploads = forgotten.filter(|noted| matches!(noted.kind, Kind::Upload { .. })).count();
        state.uploads -= uploads as u64;
        state.before += gone;
        let before = state.before;
        state.numbers.retain(|_, number| *number > before);
        state.imports.retain(|_, number| *number > before);
        state.controls.retain(|number, _| *number > before);
    }

    /// Waits, but not beyond the end; false at the end.
    pub(super) fn pause(&self, time: Duration) -> bool {
        let (state, _) = self
            .changed
            .wait_timeout_while(self.lock(), time, |state| !state.ended)
            .unwrap_or_else(PoisonError::into_inner);
        !state.ended
    }

    /// Was the end called?
    pub(super) fn ended(&self) -> bool {
        self.lock().ended
    }

    /// Wakes whoever waits in [`Index::next`] for the last time.
    pub(super) fn end(&self) {
        self.lock().ended = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Every change is made in one step: a panic elsewhere leaves the state whole.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn newest(&self) -> u64 {
        self.before + self.records.len() as u64
    }

    fn get(&self, number: u64) -> Option<&Noted> {
        self.records.get(number.checked_sub(self.before + 1)? as usize)
    }

    fn find(&self, id: Uuid) -> Option<Written> {
        let number = *self.numbers.get(&id)?;
        Some(Written { number, at: self.get(number)?.at })
    }

    fn numbered(&self) -> impl Iterator<Item = (u64, &Noted)> {
        (self.before + 1..).zip(&self.records)
    }

    fn group(&self, after: u64, last: u64) -> Vec<Written> {
        let mut bytes = 0;
        let from = after.saturating_sub(self.before) as usize;
        let next = self.records.get(from..).unwrap_or_default().iter().zip(self.before + from as u64 + 1..);
        let group = next.take_while(|(noted, number)| {
            let fits = bytes < FOLD_BYTES && *number <= last;
            bytes += u64::from(noted.at.length);
            fits
        });
        group.take(FOLD_RECORDS).map(|(noted, number)| Written { number, at: noted.at }).collect()
    }
}
