//! The storage engine of one machine: the journal in files, the tiles in sled.

use std::io::{Read, Write};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;

use echofix_core::geo::{TileId, Zone};
use echofix_core::time::day_of;
use tokio::sync::watch;
use uuid::Uuid;

use crate::store::api::{
    Error, HistoryEvent, Imported, MapProgress, MapStatus, MapStore, Operations, QuarantinedRecord, Receipt,
    Region, Snapshot, StoredTile, TileInfo, Totals, UploadRecord, Verified, io_error,
};
use crate::store::local::data_dir::DataDir;
use crate::store::log::entry::{self, Action, Control, RecordKind, RecordMeta};
use crate::store::log::index::{JournalIndex, Reserved};
use crate::store::log::journal::{Journal, Written};
use crate::store::map::build;
use crate::store::map::checkpoint::Checkpoint;
use crate::store::map::context::StoreContext;
use crate::store::map::fold::unreadable;
use crate::store::map::fold_worker::{self, FoldWorker};
use crate::store::map::generation::Generation;
use crate::store::map::manifest::{Found, Manifest};
use crate::store::operations::{backup, history, region, verify};
use crate::store::options::Options;

/// Journal and tiles on local disks. Dropping it finishes what is being written.
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
        let dir = DataDir::open(&options.data_dir)?;
        let index = Arc::new(JournalIndex::default());
        let found = Journal::recover(&dir.journal(), |written, payload| {
            index.insert(&entry::meta(payload).ok_or_else(|| unreadable(written.number))?, written);
            Ok(())
        })?;
        index.begin_after(found.end());
        let checkpoint = Checkpoint::newest(dir.root(), found.id())?;
        if checkpoint.last < index.before() {
            return Err(build::uncovered(index.before(), checkpoint.last));
        }
        let manifest = manifest_of(&dir, options, found.id())?;
        let sound = manifest.is_some();
        let policy = options.policy.digest();
        let lineage = match &manifest {
            Some(manifest) if manifest.policy == policy => manifest.lineage,
            _ => getrandom::u64().map_err(|error| io_error("drawing a lineage")(error.into()))?,
        };
        let mut worker = resume(&dir, options, manifest, &index)?;
        if worker.on.is_none() && index.newest() == 0 {
            worker.on = Some(first(&dir, options, found.id(), lineage)?);
        }
        dir.clean(found.id(), worker.on.as_ref().map(|generation| generation.number), sound)?;
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
        let journal = Journal::start(
            &dir.journal(),
            found,
            (options.segment_bytes, dir.fence().clone()),
            deliver,
            refusing,
        )?;
        let (journal, served) = ((journal_id, lineage, journal), (worker.on.clone(), checkpoint.clone()));
        let shared = Arc::new(StoreContext::new(dir, options, journal, index, progress, served));
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

    pub(super) fn append(&self, meta: RecordMeta, fresh: bool, payload: Vec<u8>) -> Result<Written, Error> {
        let written = self.shared.journal.append(meta, fresh, payload);
        written.inspect_err(|error| self.shared.note_stop(error))
    }

    /// Writes a control; the caller holds [`StoreContext::decide`].
    fn control(&self, action: Action) -> Result<u64, Error> {
        let at_us = self.shared.clock.now_us();
        let (meta, payload) = entry::control(day_of(at_us), Control { at_us, action });
        // Compacted segments end where the compaction begins.
        let fresh = matches!(action, Action::Compact(_));
        let written = self.append(meta, fresh, payload)?;
        tracing::info!(number = written.number, action = action.word(), "a control was written");
        Ok(written.number)
    }
}

/// The manifest, if it is of this journal. Any other is set aside: it may be what a restored journal lacks.
fn manifest_of(dir: &DataDir, options: &Options, journal: Uuid) -> Result<Option<Manifest>, Error> {
    match Manifest::read(dir.root(), &options.policy)? {
        Found::None => Ok(None),
        Found::Sound(manifest) if manifest.journal == journal => Ok(Some(manifest)),
        Found::Sound(_) => dir.set_aside("manifest", "a manifest of another journal").map(|()| None),
        Found::Damaged => dir.set_aside("manifest", "a damaged manifest").map(|()| None),
    }
}

/// Opens the generation that the manifest names. One that is damaged or gone is made anew.
fn resume(
    dir: &DataDir,
    options: &Options,
    manifest: Option<Manifest>,
    index: &JournalIndex,
) -> Result<FoldWorker, Error> {
    let nothing = FoldWorker { on: None, applied: 0, folded: index.before() };
    let Some(Manifest { generation: number, applied, journal, policy, .. }) = manifest else {
        return Ok(nothing);
    };
    let (cache_bytes, publish) = (options.cache_bytes, options.policy.publish_contributors);
    match Generation::open(&dir.generation(number), number, cache_bytes, journal, publish) {
        Ok(on) if on.folded() > index.newest() => Err(journal_is_short(on.folded(), index.newest())),
        Ok(on) if on.folded() < applied.max(index.before()) => {
            tracing::warn!(folded = on.folded(), applied, "the tiles are not whole; folding them anew");
            Ok(nothing)
        }
        Ok(_) if policy != options.policy.digest() => {
            tracing::warn!("what counts and what is served was configured anew; folding the tiles anew");
            Ok(nothing)
        }
        Ok(on) => {
            let folded = on.folded();
            Ok(FoldWorker { on: Some(Arc::new(on)), applied, folded })
        }
        Err(reason) => {
            tracing::warn!(%reason, "the tiles cannot be used; folding them anew");
            Ok(nothing)
        }
    }
}

/// The empty generation of a new journal.
fn first(dir: &DataDir, options: &Options, journal: Uuid, lineage: u64) -> Result<Arc<Generation>, Error> {
    let number = dir.next_generation()?;
    let (cache_bytes, publish) = (options.cache_bytes, options.policy.publish_contributors);
    let generation = Generation::create(&dir.generation(number), number, journal, (cache_bytes, publish))?;
    generation.load(&Checkpoint::default())?;
    generation.complete(journal)?;
    let policy = options.policy.digest();
    Manifest { journal, generation: number, applied: 0, lineage, policy }.write(dir.root())?;
    Ok(Arc::new(generation))
}

/// Tiles are folded from records on disk only, so the journal has lost some.
fn journal_is_short(folded: u64, end: u64) -> Error {
    Error::Damaged {
        what: "the journal".to_owned(),
        reason: format!(
            "it ends at record {end} but the tiles hold record {folded}: acknowledged uploads are missing. \
             Restore the journal, or delete the manifest to go on without them"
        ),
    }
}

impl MapStore for EmbeddedStore {
    fn contributor(&self, pseudonym: &str) -> u64 {
        self.shared.dir.contributor(pseudonym)
    }

    fn lineage(&self) -> u64 {
        self.shared.lineage
    }

    fn commit(&self, upload: UploadRecord) -> Result<Receipt, Error> {
        match self.shared.index.reserve(upload.id) {
            Reserved::Counted(written) => self.counted_as(written),
            Reserved::New(_reservation) => {
                let (meta, payload) = entry::upload(self.shared.clock.today(), &upload);
                Ok(Receipt::Counted { epoch: self.append(meta, false, payload)?.number })
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
        Ok(Some(StoredTile { version, tile: self.shared.policy.served(tile, today).into() }))
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

    fn zones(&self) -> Vec<Zone> {
        self.shared.served().map(|generation| generation.catalog().zones()).unwrap_or_default()
    }

    fn totals(&self) -> Totals {
        let compacted = self.shared.compacted_uploads.load(Ordering::Relaxed);
        let uploads = compacted + self.shared.index.uploads();
        let totals = self.shared.served().map(|generation| generation.catalog().totals(uploads));
        totals.unwrap_or(Totals { uploads, ..Totals::default() })
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
    fn revoke_contributor(&self, pseudonym: &str) -> Result<u64, Error> {
        let _deciding = self.shared.decide();
        let contributor = self.shared.dir.contributor(pseudonym);
        let compacted = self.shared.index.compacted();
        if !self.shared.index.any_after(compacted, RecordKind::Upload { contributor }) {
            return Err(Error::Unknown(
                "this contributor has uploaded nothing that is not compacted".to_owned(),
            ));
        }
        self.control(Action::RevokeContributor(contributor))
    }

    fn revoke_upload(&self, id: Uuid) -> Result<u64, Error> {
        let _deciding = self.shared.decide();
        let (index, compacted) = (&self.shared.index, self.shared.index.compacted());
        let an_upload = index.find(id).is_some_and(|written| written.number > compacted);
        if !an_upload && !index.any_after(compacted, RecordKind::Import { file: id }) {
            return Err(Error::Unknown(format!(
                "no upload or imported file {id} that is not compacted is known"
            )));
        }
        self.control(Action::RevokeUpload(id))
    }

    fn rollback(&self, epoch: u64) -> Result<u64, Error> {
        let _deciding = self.shared.decide();
        history::in_journal(&self.shared, epoch)?;
        self.control(Action::Rollback(epoch))
    }

    fn compact(&self, before_day: u16) -> Result<Option<u64>, Error> {
        let _deciding = self.shared.decide();
        let Some(last) = self.shared.index.last_before(before_day) else { return Ok(None) };
        if self.shared.index.compacted() >= last {
            return Ok(None);
        }
        self.control(Action::Compact(last)).map(Some)
    }

    fn quarantined(&self) -> Result<Vec<QuarantinedRecord>, Error> {
        self.shared.readable()?.tiles.quarantined()
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
