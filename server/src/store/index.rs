//! Which uploads are counted, and where they lie in the journal.

use std::collections::{HashMap, HashSet};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use uuid::Uuid;

use super::journal::{Position, Written};

/// Bytes of records handed out for folding at a time, but for a single larger one.
const FOLD_BYTES: u64 = 8 << 20;

/// What the journal holds, in memory.
#[derive(Default)]
pub(super) struct Index {
    state: Mutex<State>,
    /// An upload was written or given up, or the end was called.
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Number by upload id.
    numbers: HashMap<Uuid, u64>,
    /// Positions in order: number 1 first.
    positions: Vec<Position>,
    /// Uploads being written.
    pending: HashSet<Uuid>,
    ended: bool,
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

    /// Notes an upload that is in the journal. They come in order of their numbers.
    pub(super) fn note(&self, id: Uuid, written: Written) {
        let mut state = self.lock();
        debug_assert_eq!(written.number, state.positions.len() as u64 + 1);
        state.positions.push(written.at);
        state.numbers.insert(id, written.number);
        self.changed.notify_all();
    }

    /// Number of the newest upload.
    pub(super) fn newest(&self) -> u64 {
        self.lock().positions.len() as u64
    }

    /// The next uploads after a number, waiting until there are any; `None` at the end.
    pub(super) fn after(&self, number: u64) -> Option<Vec<Written>> {
        let mut state = self.lock();
        while !state.ended && state.positions.len() as u64 <= number {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if state.ended {
            return None;
        }
        let mut bytes = 0;
        let from = number as usize;
        let next = state.positions.get(from..).unwrap_or_default().iter().zip(number + 1..);
        let group = next.take_while(|(at, _)| {
            let fits = bytes < FOLD_BYTES;
            bytes += u64::from(at.length);
            fits
        });
        Some(group.map(|(at, number)| Written { number, at: *at }).collect())
    }

    /// Waits, but not beyond the end; false at the end.
    pub(super) fn pause(&self, time: Duration) -> bool {
        let (state, _) = self
            .changed
            .wait_timeout_while(self.lock(), time, |state| !state.ended)
            .unwrap_or_else(PoisonError::into_inner);
        !state.ended
    }

    /// Wakes whoever waits in [`Index::after`] for the last time.
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
    fn find(&self, id: Uuid) -> Option<Written> {
        let number = *self.numbers.get(&id)?;
        Some(Written { number, at: *self.positions.get(number as usize - 1)? })
    }
}
