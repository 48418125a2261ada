//! What happened of late, numbered, so that a listener that was away can be told what it missed.
//!
//! Numbers are this run's own: an id names the run, too, and none outlives it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use tokio::sync::watch;
use uuid::Uuid;

/// Events that are kept, of all kinds.
const KEPT: usize = 2_000;
/// Events that a listener takes at once.
const AT_ONCE: usize = 64;

/// Something that happened.
#[derive(Debug)]
pub struct NumberedEvent {
    /// Its number in this run, from 1 on, without gaps.
    pub number: u64,
    /// The name of its kind.
    pub kind: &'static str,
    /// JSON, for operators.
    pub data: String,
    /// The same as viewers may know it; nothing where they may not.
    pub for_viewers: Option<String>,
}

/// A bounded memory of events.
pub struct EventLog {
    run: String,
    kept: Mutex<VecDeque<Arc<NumberedEvent>>>,
    newest: watch::Sender<u64>,
}

impl Default for EventLog {
    fn default() -> Self {
        let (run, newest) = (Uuid::now_v7().simple().to_string(), watch::Sender::new(0));
        Self { run, kept: Mutex::default(), newest }
    }
}

impl EventLog {
    /// Adds an event, and the same as viewers may know it; wakes those who follow.
    pub fn add<T: Serialize>(&self, kind: &'static str, body: &T, for_viewers: Option<&T>) {
        // Our own plain structs always have a JSON form.
        let json = |body: &T| serde_json::to_string(body).unwrap_or_default();
        let (data, for_viewers) = (json(body), for_viewers.map(json));
        let mut kept = self.lock();
        let number = self.newest() + 1;
        if kept.len() == KEPT {
            kept.pop_front();
        }
        kept.push_back(Arc::new(NumberedEvent { number, kind, data, for_viewers }));
        self.newest.send_replace(number);
    }

    /// The number of the newest event; 0 before the first.
    pub fn newest(&self) -> u64 {
        *self.newest.borrow()
    }

    /// Follows the number of the newest event.
    pub fn follow(&self) -> watch::Receiver<u64> {
        self.newest.subscribe()
    }

    /// How many events after a number are no longer kept, and the next ones that are, oldest first.
    pub fn after(&self, number: u64) -> (u64, Vec<Arc<NumberedEvent>>) {
        let kept = self.lock();
        let oldest = kept.front().map_or(number + 1, |event| event.number);
        let gone = oldest.saturating_sub(number + 1);
        let known = (number + 1).saturating_sub(oldest);
        (gone, kept.iter().skip(known as usize).take(AT_ONCE).cloned().collect())
    }

    /// The id of the event of a number.
    pub fn id(&self, number: u64) -> String {
        format!("{}-{number}", self.run)
    }

    /// The number of an event of this run; `None` for what is no id of it.
    pub fn number(&self, id: &str) -> Option<u64> {
        let (run, number) = id.rsplit_once('-')?;
        number.parse().ok().filter(|number| run == self.run && *number <= self.newest())
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Arc<NumberedEvent>>> {
        // A panic while holding the lock leaves a queue that is still a queue.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Catches: an id of another run, or one not yet given, that is taken for one of this run.
    #[test]
    fn only_ids_of_this_run_have_a_number() {
        let (log, other) = (EventLog::default(), EventLog::default());
        (0..3).for_each(|n| log.add("fix", &n, None));
        (0..3).for_each(|n| other.add("fix", &n, None));
        assert_eq!((log.number(&log.id(0)), log.number(&log.id(3))), (Some(0), Some(3)));
        for id in [
            log.id(4),
            other.id(2),
            "2".to_owned(),
            String::new(),
            "-2".to_owned(),
            format!("{} ", log.id(2)),
        ] {
            assert_eq!(log.number(&id), None, "{id}");
        }
    }

    proptest! {
        /// Catches: an event that a listener is neither told nor told to have missed, or is told twice.
        #[test]
        fn every_event_is_told_or_counted_as_missed(before in 0..3_000_u64, behind in 0..3_000_u64) {
            let log = EventLog::default();
            (0..before).for_each(|n| log.add("fix", &n, None));
            let mut last = before.saturating_sub(behind);
            let (gone, _) = log.after(last);
            prop_assert_eq!(gone, (before - last).saturating_sub(KEPT as u64));
            last += gone;
            loop {
                let (gone, events) = log.after(last);
                prop_assert_eq!(gone, 0);
                let Some(newest) = events.last() else { break };
                prop_assert!(events.iter().zip(last + 1..).all(|(event, number)| event.number == number));
                last = newest.number;
            }
            prop_assert_eq!(last, before);
        }
    }
}
