//! Log lines that a caller can cause: one of a kind in half a minute, which says how many were left out.
//!
//! Without that, one client that is refused a thousand times a second fills a disk in days. What is left out is counted.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between two lines of a kind.
const BETWEEN: Duration = Duration::from_secs(30);

static LINES: SparseLines = SparseLines::new(BETWEEN);

/// Whether a line of this kind may be written now: then how many were left out since the last one.
///
/// There must be few kinds, and none that a caller can choose.
pub(crate) fn line(kind: &'static str) -> Option<u64> {
    LINES.line(kind, Instant::now())
}

/// Lines that were left out so far, of all kinds.
pub(crate) fn left_out() -> u64 {
    LINES.state().left_out
}

struct SparseLines {
    between: Duration,
    state: Mutex<State>,
}

struct State {
    /// When the last line of a kind was written, and how many were left out since.
    kinds: BTreeMap<&'static str, (Instant, u64)>,
    left_out: u64,
}

impl SparseLines {
    const fn new(between: Duration) -> Self {
        Self { between, state: Mutex::new(State { kinds: BTreeMap::new(), left_out: 0 }) }
    }

    fn line(&self, kind: &'static str, now: Instant) -> Option<u64> {
        let mut state = self.state();
        let Some((last, since)) = state.kinds.get_mut(kind) else {
            state.kinds.insert(kind, (now, 0));
            return Some(0);
        };
        if now.saturating_duration_since(*last) < self.between {
            *since += 1;
            state.left_out += 1;
            return None;
        }
        *last = now;
        Some(std::mem::take(since))
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        // Counts stay counts even if a holder panicked.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a line for every refusal, and lines of one kind that keep another's out.
    #[test]
    fn a_kind_has_one_line_in_a_while_and_each_says_what_was_left_out() {
        let lines = SparseLines::new(Duration::from_secs(30));
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        assert_eq!(lines.line("TOO_SLOW", at(0)), Some(0));
        for _ in 0..10_000 {
            assert_eq!(lines.line("TOO_SLOW", at(29)), None);
        }
        assert_eq!(lines.line("INVALID", at(29)), Some(0));
        assert_eq!(lines.line("TOO_SLOW", at(30)), Some(10_000));
        assert_eq!(lines.line("TOO_SLOW", at(31)), None);
        assert_eq!(lines.state().left_out, 10_001);
    }
}
