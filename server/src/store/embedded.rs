//! The storage engine of one process, over a backend.

use std::collections::{BTreeSet, HashMap};
use std::io::{Read, Write};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;

use echofix_core::geo::{TileId, Zone};
use echofix_core::time::day_of;
use tokio::sync::{broadcast, watch};
use uuid::Uuid;

use crate::store::api::{
    ContributedUpload, ContributorFigures, Error, FoldingFigures, HistoryEvent, Imported, InspectedTile,
    MapProgress, MapStatus, MapStore, Operations, Preparing, Preview, Proposal, QuarantinedRecord, Receipt,
    Region, Remark, Snapshot, StoredTile, TileInfo, Totals, UploadRecord, Verified, Withheld, io_error,
};
use crate::store::backend::Backend;
use crate::store::local;
use crate::store::log::entry::{self, Action, Control, RecordMeta};
use crate::store::log::index::{JournalIndex, Reserved};
use crate::store::log::journal::{Journal, RecoveredJournal};
use crate::store::log::position::Written;
use crate::store::log::sequencer::{NewRecord, Sequenced};
use crate::store::map::build;
use crate::store::map::checkpoint::Checkpoint;
use crate::store::map::context::{Settings, StoreContext};
use crate::store::map::fold::unreadable;
use crate::store::map::fold_worker::{self, FoldWorker};
use crate::store::map::resume;
use crate::store::map::write_buffer::Source as _;
use crate::store::operations::{backup, contributors, decide, history, past, region, verify};
use crate::store::options::Options;

/// A journal and the tiles that are folded from it, by default on local disks. Dropping it finishes what is being written.
pub struct EmbeddedStore {
    pub(super) shared: Arc<StoreContext>,
    worker: Option<JoinHandle<()>>,
}

impl EmbeddedStore {
    /// Opens a data directory: checks the whole journal and every tile, then resumes folding in
    /// the background. The map can be read once [`MapStore::progress`] says so.
    ///
    /// # Errors
    /// When the directory is in use, the disk refuses, or an acknowledged upload is damaged.
    pub fn open(options: &Options) -> Result<Self, Error> {
        Self::over(local::open(&options.data_dir, options.table, options.cache_bytes)?, options.settings())
    }

    /// Opens what a backend holds.
    pub(super) fn over(backend: Backend, settings: Settings) -> Result<Self, Error> {
        let index = Arc::new(JournalIndex::default());
        let found = Journal::recover(&*backend.segments, |written, payload| {
            index.insert(&entry::meta(payload).ok_or_else(|| unreadable(written.number))?, written);
            Ok(())
        })?;
        index.begin_after(found.end());
        let checkpoint = Checkpoint::newest(&*backend.objects, found.id())?;
        if checkpoint.last < index.before() {
            return Err(build::uncovered(index.before(), checkpoint.last));
        }
        let (lineage, worker) =
            resume::resume(&backend, (&settings.policy, settings.lineage), found.id(), &index)?;
        let shared = started(backend, settings, (found, checkpoint.clone()), index, (lineage, &worker))?;
        if worker.on.is_some() && worker.applied >= shared.index.newest_control() {
            build::discard_compacted(&shared, checkpoint)?;
        }
        let thread = {
            let shared = shared.clone();
            let thread = std::thread::Builder::new().name("fold".to_owned());
            thread
                .spawn(move || fold_worker::run(&shared, worker))
                .map_err(io_error("starting the folding thread"))?
        };
        Ok(Self { shared, worker: Some(thread) })
    }

    fn counted_as(&self, written: Written) -> Result<Receipt, Error> {
        let payload = self.shared.journal.reader().payload(written.at)?;
        let answer = entry::answer(&payload).ok_or_else(|| unreadable(written.number))?;
        Ok(Receipt::Duplicate { epoch: written.number, answer })
    }

    fn append(&self, meta: RecordMeta, fresh: bool, payload: Vec<u8>) -> Result<Sequenced, Error> {
        let submitted = self.shared.journal.submit(vec![NewRecord { meta, fresh, payload, number: None }]);
        let written = submitted.inspect_err(|error| self.shared.note_stop(error))?;
        written.first().copied().ok_or_else(|| Error::Stopped("a record was lost on its way".to_owned()))
    }

    /// Writes a control; the caller holds [`StoreContext::decide`].
    fn control(&self, action: Action, remark: &Remark) -> Result<u64, Error> {
        let at_us = self.shared.settings.clock.now_us();
        let (meta, payload) =
            entry::control(day_of(at_us), &Control { at_us, action, remark: remark.clone() });
        let fresh = meta.begins_segment();
        let written = self.append(meta, fresh, payload)?.written;
        tracing::info!(number = written.number, action = action.word(), "a control was written");
        Ok(written.number)
    }
}

/// The journal begins to take records; nothing is folded yet.
fn started(
    backend: Backend,
    settings: Settings,
    (found, checkpoint): (RecoveredJournal, Checkpoint),
    index: Arc<JournalIndex>,
    (lineage, worker): (u64, &FoldWorker),
) -> Result<Arc<StoreContext>, Error> {
    let end = index.newest();
    // What is served is the last good epoch; what was journaled after it is folded behind it.
    let state = if worker.on.is_some() { MapStatus::Serving } else { MapStatus::Rebuilding };
    let epoch = worker.folded;
    let progress = watch::Sender::new(MapProgress {
        state,
        epoch,
        journaled: end,
        building: None,
        stopped: false,
        refusing: false,
    });
    let refusing = {
        let progress = progress.clone();
        move |now| progress.send_modify(|progress| progress.refusing = now)
    };
    let deliver = {
        let (index, progress) = (index.clone(), progress.clone());
        move |meta: RecordMeta, written: Written| {
            // The index wakes the folding thread, which must not be ahead of the progress.
            progress.send_modify(|progress| progress.journaled = written.number);
            index.insert(&meta, written);
        }
    };
    let journal_id = found.id();
    let (segments, fence) = (backend.segments.clone(), backend.fence.clone());
    let journal = Journal::start(segments, found, (settings.segment_bytes, fence), deliver, refusing)?;
    let (journal, served) = ((journal_id, lineage, journal), (worker.on.clone(), checkpoint));
    Ok(Arc::new(StoreContext::new(backend, settings, journal, index, progress, served)))
}

impl MapStore for EmbeddedStore {
    fn contributor(&self, pseudonym: &str) -> u64 {
        self.shared.backend.pseudonyms.hash(pseudonym)
    }

    fn lineage(&self) -> u64 {
        self.shared.lineage
    }

    fn commit(&self, upload: UploadRecord) -> Result<Receipt, Error> {
        match self.shared.index.reserve(upload.id) {
            Reserved::Counted(written) => self.counted_as(written),
            Reserved::New(_reservation) => {
                let (meta, payload) = entry::upload(self.shared.settings.clock.today(), &upload);
                let Sequenced { written, known } = self.append(meta, false, payload)?;
                // Another server may have counted it meanwhile.
                if known { self.counted_as(written) } else { Ok(Receipt::Counted { epoch: written.number }) }
            }
        }
    }

    fn counted(&self, id: Uuid) -> Result<Option<Receipt>, Error> {
        self.shared.index.find(id).map(|written| self.counted_as(written)).transpose()
    }

    fn tile(&self, id: TileId) -> Result<Option<StoredTile>, Error> {
        let generation = self.shared.readable()?;
        if generation.catalog().get(id).is_none_or(|info| info.cells == 0) {
            return Ok(None);
        }
        let lost = || Error::Damaged { what: format!("tile {id}"), reason: "it is gone".to_owned() };
        let (version, tile) = generation.tiles.stored(id)?.ok_or_else(lost)?;
        let today = generation.catalog().newest_day();
        let tile = self.shared.settings.policy.served(tile, today).into();
        Ok(Some(StoredTile { version, day: today, tile }))
    }

    fn inspect(&self, id: TileId) -> Result<Option<InspectedTile>, Error> {
        let generation = self.shared.readable()?;
        if generation.catalog().get(id).is_none() {
            return Ok(None);
        }
        let folded = generation.tiles.folded(id)?;
        let today = generation.catalog().newest_day();
        Ok(Some(self.shared.settings.policy.inspected(folded, today)))
    }

    fn catalog(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Vec<TileInfo>, Error> {
        let mut found = self.shared.readable()?.catalog().block(zone, &x, &y);
        // That a contributor drove there is private until enough did.
        found.retain(|info| info.cells > 0);
        Ok(found)
    }

    fn withheld(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Option<Withheld>, Error> {
        let needed = self.shared.settings.policy.publish_contributors;
        Ok(self.shared.readable()?.catalog().withheld((zone, &x, &y), needed))
    }

    fn zones(&self) -> Vec<Zone> {
        self.shared.served().map(|generation| generation.catalog().zones()).unwrap_or_default()
    }

    fn totals(&self) -> Totals {
        let compacted = self.shared.compacted_uploads.load(Ordering::Relaxed);
        let uploads = compacted + self.shared.index.uploads();
        let needed = self.shared.settings.policy.publish_contributors;
        let totals = self.shared.served().map(|generation| generation.catalog().totals(uploads, needed));
        totals.unwrap_or(Totals { uploads, needed, ..Totals::default() })
    }

    fn newest_day(&self) -> u16 {
        self.shared.served().map_or(0, |generation| generation.catalog().newest_day())
    }

    fn before_serving(&self, prepare: Preparing) {
        self.shared.prepare_by(prepare);
    }

    fn progress(&self) -> watch::Receiver<MapProgress> {
        self.shared.progress.subscribe()
    }

    fn hang(&self) -> Option<String> {
        if self.worker.as_ref().is_none_or(JoinHandle::is_finished) {
            return Some("the folding thread has ended".to_owned());
        }
        self.shared.beat.silence().map(|silence| format!("folding hangs, for {} s", silence.as_secs()))
    }
}

impl Operations for EmbeddedStore {
    fn decide(&self, proposal: &Proposal, remark: &Remark) -> Result<Option<u64>, Error> {
        let _deciding = self.shared.decide();
        let action = decide::action(&self.shared, proposal)?;
        action.map(|action| self.control(action, remark)).transpose()
    }

    fn preview(&self, proposal: &Proposal) -> Result<Preview, Error> {
        decide::preview(&self.shared, proposal)
    }

    fn folding(&self) -> FoldingFigures {
        self.shared.folding()
    }

    fn upload_ids(&self, numbers: &BTreeSet<u64>) -> HashMap<u64, Uuid> {
        self.shared.index.ids(numbers)
    }

    fn contributors(&self) -> Result<Vec<ContributorFigures>, Error> {
        contributors::all(&self.shared)
    }

    fn uploads_of(&self, hash: u64, before: u64, limit: usize) -> Result<Vec<ContributedUpload>, Error> {
        contributors::uploads_of(&self.shared, hash, before, limit)
    }

    fn upload(&self, id: Uuid) -> Result<Option<(u64, ContributedUpload)>, Error> {
        contributors::upload(&self.shared, id)
    }

    fn epochs(&self) -> (u64, u64) {
        history::epochs(&self.shared)
    }

    fn served_at(&self, epoch: u64) -> Result<Arc<dyn MapStore>, Error> {
        past::served_at(&self.shared, epoch)
    }

    fn quarantined(&self) -> Result<Vec<QuarantinedRecord>, Error> {
        self.shared.readable()?.tiles.quarantined()
    }

    fn kept_out(&self) -> broadcast::Receiver<QuarantinedRecord> {
        self.shared.kept_out.subscribe()
    }

    fn history(&self, limit: usize) -> Vec<HistoryEvent> {
        history::events(&self.shared, limit)
    }

    fn at(&self, epoch: u64) -> Result<Snapshot, Error> {
        history::snapshot(&self.shared, epoch)
    }

    fn export(&self, region: &Region, out: &mut dyn Write) -> Result<u64, Error> {
        region::export(&self.shared, region, out)
    }

    fn import(&self, file: &mut dyn Read) -> Result<Imported, Error> {
        region::import(&self.shared, file)
    }

    fn backup(&self, out: &mut dyn Write) -> Result<u64, Error> {
        backup::write(&self.shared, out)
    }

    fn verify(&self, replay: bool) -> Result<Verified, Error> {
        verify::verified(&self.shared, replay)
    }

    fn wind_down(&self) {
        self.shared.index.end();
    }
}

impl Drop for EmbeddedStore {
    fn drop(&mut self) {
        self.shared.index.end();
        if let Some(worker) = self.worker.take() {
            // What it did not fold is folded at the next start.
            let _ = worker.join();
        }
    }
}
