//! The storage engine of one machine: the journal in files, the tiles in sled.

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::sync::{Arc, RwLock};
use std::thread::JoinHandle;

use echofix_core::geo::{TileId, Zone};
use tokio::sync::watch;
use uuid::Uuid;

use super::catalog::Catalog;
use super::data_dir::DataDir;
use super::fold::{self, Resumed};
use super::index::{Claim, Index};
use super::journal::{Journal, Written};
use super::shared::Shared;
use super::{
    Error, MapStore, Progress, Receipt, State, StoredTile, TileInfo, Totals, Upload, io_error, record,
};

/// Where and how an [`EmbeddedStore`] keeps its data.
#[derive(Debug, Clone)]
pub struct Options {
    /// The data directory; made if missing.
    pub data_dir: PathBuf,
    /// Memory for sled's cache, bytes.
    pub cache_bytes: u64,
    /// Size from which a journal segment is followed by the next, bytes; at most 1 GiB.
    pub segment_bytes: u64,
}

/// Journal and tiles on local disks. Dropping it finishes what is being written.
pub struct EmbeddedStore {
    shared: Arc<Shared>,
    dir: DataDir,
    folder: Option<JoinHandle<()>>,
}

impl EmbeddedStore {
    /// Opens a data directory: checks the whole journal and every tile, then resumes folding in
    /// the background. The map can be read once [`MapStore::progress`] says so.
    ///
    /// # Errors
    /// When the directory is in use, the disk refuses, or an acknowledged upload is damaged.
    pub fn open(options: &Options) -> Result<Self, Error> {
        let dir = DataDir::open(&options.data_dir)?;
        let index = Arc::new(Index::default());
        let mut newest = HashMap::new();
        let found = Journal::recover(&dir.journal(), |written, payload| {
            let head = record::decode_head(payload).ok_or_else(|| fold::unreadable(written.number))?;
            newest.extend(head.tiles.iter().map(|(id, _)| (*id, written.number)));
            index.note(head.id, written);
            Ok(())
        })?;
        let end = index.newest();
        let Resumed { tiles, sound, folded } =
            fold::resume(&dir.tiles(), options.cache_bytes, found.id(), &newest, end)?;
        let progress = watch::Sender::new(Progress {
            state: State::Rebuilding,
            epoch: folded,
            journaled: end,
            stopped: false,
        });
        let deliver = {
            let (index, progress) = (index.clone(), progress.clone());
            move |id: Uuid, written: Written| {
                // Noting wakes the folding thread: it must not be ahead of what is told.
                progress.send_modify(|progress| progress.journaled = written.number);
                index.note(id, written);
            }
        };
        let journal = Journal::start(&dir.journal(), found, options.segment_bytes, deliver)?;
        let mut catalog = Catalog::default();
        for info in sound {
            catalog.put(info);
        }
        let shared = Arc::new(Shared { journal, index, tiles, catalog: RwLock::new(catalog), progress });
        if folded == end {
            shared.set_state(State::Serving);
        }
        let folder = {
            let shared = shared.clone();
            let thread = std::thread::Builder::new().name("fold".to_owned());
            thread.spawn(move || fold::run(&shared)).map_err(io_error("starting the folding thread"))?
        };
        Ok(Self { shared, dir, folder: Some(folder) })
    }

    fn counted_as(&self, written: Written) -> Result<Receipt, Error> {
        let payload = self.shared.journal.reader().payload(written.at)?;
        let head = record::decode_head(&payload).ok_or_else(|| fold::unreadable(written.number))?;
        Ok(Receipt::Duplicate { epoch: written.number, answer: head.answer })
    }
}

impl MapStore for EmbeddedStore {
    fn contributor(&self, pseudonym: &str) -> u64 {
        self.dir.contributor(pseudonym)
    }

    fn commit(&self, upload: Upload) -> Result<Receipt, Error> {
        match self.shared.index.claim(upload.id) {
            Claim::Counted(written) => self.counted_as(written),
            Claim::Ours(_pending) => {
                let written = self.shared.journal.append(upload.id, record::encode(&upload));
                let written = written.inspect_err(|error| self.shared.note_stop(error))?;
                Ok(Receipt::Counted { epoch: written.number })
            }
        }
    }

    fn counted(&self, id: Uuid) -> Result<Option<Receipt>, Error> {
        self.shared.index.find(id).map(|written| self.counted_as(written)).transpose()
    }

    fn tile(&self, id: TileId) -> Result<Option<StoredTile>, Error> {
        self.shared.readable()?;
        if self.shared.catalog().get(id).is_none() {
            return Ok(None);
        }
        let lost = || Error::Damaged { what: format!("tile {id}"), reason: "it is gone".to_owned() };
        self.shared.tiles.stored(id)?.ok_or_else(lost).map(Some)
    }

    fn catalog(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Vec<TileInfo>, Error> {
        self.shared.readable()?;
        Ok(self.shared.catalog().block(zone, &x, &y))
    }

    fn zones(&self) -> Vec<Zone> {
        self.shared.catalog().zones()
    }

    fn totals(&self) -> Totals {
        let uploads = self.shared.progress.borrow().journaled;
        self.shared.catalog().totals(uploads)
    }

    fn progress(&self) -> watch::Receiver<Progress> {
        self.shared.progress.subscribe()
    }
}

impl Drop for EmbeddedStore {
    fn drop(&mut self) {
        self.shared.index.end();
        if let Some(folder) = self.folder.take() {
            // What it did not fold is folded at the next start.
            let _ = folder.join();
        }
    }
}
