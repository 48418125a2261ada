//! The thread that prepares tiles anew which have changed, behind all else.

use std::collections::HashSet;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::JoinHandle;

use echofix_core::geo::TileId;

use super::Known;
use crate::lanes::{BACKGROUND, lower};

/// Tiles that wait to be prepared, at most; others are prepared by who needs them.
const WAITING: usize = 1024;

/// Prepares tiles on a thread of its own, from when the first is asked for.
pub(super) struct Refresher {
    known: Weak<Known>,
    asked: Arc<Mutex<HashSet<TileId>>>,
    thread: Mutex<Option<(SyncSender<TileId>, JoinHandle<()>)>>,
}

impl Refresher {
    pub(super) fn of(known: &Arc<Known>) -> Self {
        Self { known: Arc::downgrade(known), asked: Arc::default(), thread: Mutex::default() }
    }

    /// Asks for a tile; false when too many wait.
    pub(super) fn ask(&self, id: TileId) -> bool {
        if !lock(&self.asked).insert(id) {
            return true;
        }
        let mut thread = lock(&self.thread);
        if thread.is_none() {
            *thread = self.start();
        }
        let taken = thread.as_ref().is_some_and(|(sender, _)| sender.try_send(id).is_ok());
        if !taken {
            lock(&self.asked).remove(&id);
        }
        taken
    }

    fn start(&self) -> Option<(SyncSender<TileId>, JoinHandle<()>)> {
        let (sender, receiver) = sync_channel(WAITING);
        let (known, asked) = (self.known.clone(), Arc::clone(&self.asked));
        let thread = std::thread::Builder::new().name("prepare".to_owned());
        let thread = thread.spawn(move || run(&known, &asked, &receiver));
        thread
            .inspect_err(|error| tracing::warn!(%error, "no thread prepares tiles"))
            .ok()
            .map(|t| (sender, t))
    }
}

fn run(known: &Weak<Known>, asked: &Mutex<HashSet<TileId>>, receiver: &Receiver<TileId>) {
    lower(BACKGROUND);
    for id in receiver {
        // Before it is prepared: what changes meanwhile is asked for again.
        lock(asked).remove(&id);
        let Some(known) = known.upgrade() else { return };
        if let Err(error) = known.refresh(id) {
            tracing::debug!(%error, "a tile is not prepared; who needs it tries again");
        }
    }
}

impl Drop for Refresher {
    fn drop(&mut self) {
        if let Some((sender, thread)) = lock(&self.thread).take() {
            drop(sender);
            // It holds the store for as long as one tile takes.
            let _ = thread.join();
        }
    }
}

fn lock<T>(of: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // Sets and handles are whole, whoever panicked.
    of.lock().unwrap_or_else(PoisonError::into_inner)
}
