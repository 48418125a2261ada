//! What the store and its folding thread share.

use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use tokio::sync::watch;

use super::catalog::Catalog;
use super::index::Index;
use super::journal::Journal;
use super::tiles::Tiles;
use super::{Error, Progress, State};

/// What the store and its folding thread share.
pub(super) struct Shared {
    pub(super) journal: Journal,
    pub(super) index: Arc<Index>,
    pub(super) tiles: Tiles,
    pub(super) catalog: RwLock<Catalog>,
    pub(super) progress: watch::Sender<Progress>,
}

impl Shared {
    /// Nothing is answered from a map that does not show all it once showed.
    pub(super) fn readable(&self) -> Result<(), Error> {
        let Progress { state, epoch, journaled, .. } = *self.progress.borrow();
        match state {
            State::Rebuilding => Err(Error::Rebuilding { folded: epoch, journaled }),
            State::Serving | State::Stalled => Ok(()),
        }
    }

    pub(super) fn set_state(&self, state: State) {
        self.progress.send_if_modified(|progress| {
            let changed = progress.state != state;
            progress.state = state;
            changed
        });
    }

    /// A journal that stopped once accepts nothing any more, and that is told.
    pub(super) fn note_stop(&self, error: &Error) {
        if matches!(error, Error::Stopped(_)) {
            self.progress.send_if_modified(|progress| !std::mem::replace(&mut progress.stopped, true));
        }
    }

    pub(super) fn catalog(&self) -> RwLockReadGuard<'_, Catalog> {
        // A panic cannot leave the catalog half changed in a way that matters: it only counts.
        self.catalog.read().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn catalog_mut(&self) -> RwLockWriteGuard<'_, Catalog> {
        self.catalog.write().unwrap_or_else(PoisonError::into_inner)
    }
}
