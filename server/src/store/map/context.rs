//! What the store and its folding thread share.

use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, watch};
use uuid::Uuid;

use super::checkpoint::Checkpoint;
use super::generation::Generation;
use super::policy::Policy;
use crate::store::api::{
    Error, FoldingFigures, MapProgress, MapStatus, Preparing, QuarantinedRecord, StoreClock,
};
use crate::store::backend::Backend;
use crate::store::log::index::JournalIndex;
use crate::store::log::journal::Journal;

/// How long one step of folding may take: some records, or one tile of a new generation.
const STEP: Duration = Duration::from_mins(5);

/// When the folding thread was last heard of, while it has something to do.
#[derive(Default)]
pub(in crate::store) struct Heartbeat(Mutex<Option<Instant>>);

impl Heartbeat {
    /// It works.
    pub(in crate::store) fn beat(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
    }

    /// It has nothing to do.
    pub(in crate::store) fn rest(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// How long nothing was heard of it, if that is too long.
    pub(in crate::store) fn silence(&self) -> Option<Duration> {
        let last = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        last.map(|last| last.elapsed()).filter(|silence| *silence > STEP)
    }
}

/// How a store works, wherever it is stored.
#[derive(Debug, Clone)]
pub(in crate::store) struct Settings {
    /// Size from which a journal segment is followed by the next, bytes.
    pub(in crate::store) segment_bytes: u64,
    /// Tiles in memory from which on they are written before more is folded.
    pub(in crate::store) write_buffer_tiles: usize,
    /// Which evidence counts, and what of it is published.
    pub(in crate::store) policy: Policy,
    /// The lineage that servers share; `None` where this one draws its own.
    pub(in crate::store) lineage: Option<u64>,
    /// What day it is.
    pub(in crate::store) clock: StoreClock,
    /// How long folding rests after an error.
    pub(in crate::store) retry: Duration,
}

/// Quarantined uploads that a slow listener may be behind.
const TOLD: usize = 256;

/// What the store and its folding thread share.
pub(in crate::store) struct StoreContext {
    pub(in crate::store) settings: Settings,
    pub(in crate::store) journal_id: Uuid,
    pub(in crate::store) lineage: u64,
    pub(in crate::store) journal: Journal,
    pub(in crate::store) index: Arc<JournalIndex>,
    pub(in crate::store) progress: watch::Sender<MapProgress>,
    served: RwLock<Option<Arc<Generation>>>,
    /// Held for writing while compacted records go.
    checkpoint: RwLock<Checkpoint>,
    /// Uploads that only the checkpoint has.
    pub(in crate::store) compacted_uploads: AtomicU64,
    /// Tells that the folding thread works.
    pub(in crate::store) beat: Heartbeat,
    /// What folding has done; see [`Self::folding`].
    folding: Mutex<FoldingFigures>,
    /// What vetting keeps out of the served generation, as it comes.
    pub(in crate::store) kept_out: broadcast::Sender<QuarantinedRecord>,
    /// Who prepares for what is served next.
    preparing: OnceLock<Preparing>,
    /// Held while a control is decided on and written: each knows all before it.
    deciding: Mutex<()>,
    /// Declared last: given up when all else is closed.
    pub(in crate::store) backend: Backend,
}

impl StoreContext {
    pub(in crate::store) fn new(
        backend: Backend,
        settings: Settings,
        (journal_id, lineage, journal): (Uuid, u64, Journal),
        index: Arc<JournalIndex>,
        progress: watch::Sender<MapProgress>,
        (served, checkpoint): (Option<Arc<Generation>>, Checkpoint),
    ) -> Self {
        // Until they are deleted, records that the checkpoint stands for are in the index, too.
        let twice = index.uploads_within(0, checkpoint.last);
        Self {
            settings,
            journal_id,
            lineage,
            journal,
            index,
            progress,
            served: RwLock::new(served),
            compacted_uploads: AtomicU64::new(checkpoint.uploads.saturating_sub(twice)),
            checkpoint: RwLock::new(checkpoint),
            beat: Heartbeat::default(),
            folding: Mutex::default(),
            kept_out: broadcast::Sender::new(TOLD),
            preparing: OnceLock::new(),
            deciding: Mutex::default(),
            backend,
        }
    }

    /// The generation that is read. Nothing is answered from a map that does not show all it once
    /// showed.
    pub(in crate::store) fn readable(&self) -> Result<Arc<Generation>, Error> {
        let MapProgress { state, epoch, journaled, .. } = *self.progress.borrow();
        let rebuilding = Error::Rebuilding { folded: epoch, journaled };
        match state {
            MapStatus::Rebuilding => Err(rebuilding),
            MapStatus::Serving | MapStatus::Stalled => self.served().ok_or(rebuilding),
        }
    }

    pub(in crate::store) fn served(&self) -> Option<Arc<Generation>> {
        self.served.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Serves another generation from now on, and gives back the one before.
    pub(in crate::store) fn serve(&self, generation: Option<Arc<Generation>>) -> Option<Arc<Generation>> {
        std::mem::replace(&mut *self.served.write().unwrap_or_else(PoisonError::into_inner), generation)
    }

    /// The checkpoint; no compacted record goes while this is held.
    pub(in crate::store) fn checkpoint(&self) -> RwLockReadGuard<'_, Checkpoint> {
        // It is replaced in one step.
        self.checkpoint.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// The checkpoint, and the right to delete what it covers.
    pub(super) fn checkpoint_mut(&self) -> RwLockWriteGuard<'_, Checkpoint> {
        self.checkpoint.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// What folding has done since the start.
    pub(in crate::store) fn folding(&self) -> FoldingFigures {
        *self.folding.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Folding took so long for a step, and vetting has decided so much by now.
    pub(super) fn note_folded(&self, took: Duration, vetted: FoldingFigures) {
        let mut folding = self.folding.lock().unwrap_or_else(PoisonError::into_inner);
        *folding = FoldingFigures { spent: folding.spent + took, ..vetted };
    }

    /// Somebody prepares for what is served next, from now on. There is one such, the first.
    pub(in crate::store) fn prepare_by(&self, prepare: Preparing) {
        let _ = self.preparing.set(prepare);
    }

    /// Who prepares for what is served next.
    pub(super) fn preparing(&self) -> Option<&Preparing> {
        self.preparing.get()
    }

    /// The right to write a control.
    pub(in crate::store) fn decide(&self) -> MutexGuard<'_, ()> {
        self.deciding.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn set_state(&self, state: MapStatus) {
        self.progress.send_if_modified(|progress| {
            let changed = progress.state != state;
            progress.state = state;
            changed
        });
    }

    /// A journal that stopped once accepts nothing any more; the progress says so.
    pub(in crate::store) fn note_stop(&self, error: &Error) {
        if matches!(error, Error::Stopped(_)) {
            self.progress.send_if_modified(|progress| !std::mem::replace(&mut progress.stopped, true));
        }
    }
}
