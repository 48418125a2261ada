//! One of several servers that share a map: an embedded store whose records come in the order of a shared journal.
//!
//! Its data directory is a copy. Every server folds the same records with the same code, so all have the same map and
//! epochs, and any of them answers any request. What is acknowledged is in the bucket.
//!
//! - [`copy`]: the data directory is begun, and brought up to the end of the shared journal.
//! - [`sequencer`]: the thread that reads the shared journal, and appends to it.
//! - [`shared_map`]: what operators see of the bucket, and a directory's way into one.
//! - [`announcing`]: the thread by which servers know who else lives, and where.
//! - [`keeper`]: the thread that publishes what was compacted, and deletes what is no longer needed.

mod announcing;
mod copy;
mod keeper;
mod sequencer;
mod shared_map;

pub use shared_map::{SharedMap, SharedMapStatus};

use std::collections::{BTreeSet, HashMap};
use std::io::{Read, Write};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use echofix_core::geo::{TileId, Zone};
use siphasher::sip::SipHasher24;
use tokio::sync::{broadcast, watch};
use uuid::Uuid;

use crate::store::api::{
    ContributedUpload, ContributorFigures, Error, FoldingFigures, HistoryEvent, Imported, InspectedTile,
    MapProgress, MapStore, Operations, Preparing, Preview, Proposal, QuarantinedRecord, Receipt, Region,
    Remark, Snapshot, StoredTile, TileInfo, Totals, UploadRecord, Verified, Withheld, io_error,
};
use crate::store::embedded::EmbeddedStore;
use crate::store::local;
use crate::store::map::context::Settings;
use crate::store::object::chain::Chain;
use crate::store::object::client::{Client, Patience};
use crate::store::object::cluster::Cluster;
use crate::store::object::names::Shard;
use crate::store::object::probe::probe;
use crate::store::object::remote::Remote;
use crate::store::object::shared_log::{Check, SharedLog};
use crate::store::options::Options;

/// The one shard there is so far.
const SHARD: Shard = Shard(0);

/// How often what is done.
#[derive(Debug, Clone, Copy)]
pub(in crate::store) struct Pace {
    /// The shared journal is looked at, where nothing is to be appended.
    pub(in crate::store) poll: Duration,
    /// It is looked whether something is to be published.
    pub(in crate::store) keep: Duration,
    /// What is deleted is at least so old.
    pub(in crate::store) age: Duration,
    /// A server that has an address announces it.
    pub(in crate::store) announce: Duration,
}

impl Default for Pace {
    fn default() -> Self {
        let seconds = Duration::from_secs;
        Self {
            poll: Duration::from_millis(500),
            keep: seconds(30),
            age: seconds(3600),
            announce: seconds(10),
        }
    }
}

/// One of several servers that share a map in a bucket. Dropping it finishes what is being written.
pub struct ReplicatedStore {
    ended: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    /// The addresses of those that live, where this one has an address.
    living: Option<watch::Receiver<Vec<String>>>,
    /// Declared last: its threads go first.
    pub(in crate::store) copy: EmbeddedStore,
}

impl ReplicatedStore {
    /// Joins the map of `s3://bucket/prefix`, with `options.data_dir` as its copy. Credentials, region and endpoint come from
    /// the environment (`AWS_*`).
    ///
    /// # Errors
    /// When the store does not answer or ignores conditions, the directory holds another map or one that is too old, or
    /// anything of [`EmbeddedStore::open`].
    pub fn open(url: &str, options: &Options) -> Result<Self, Error> {
        let client = Client::new(Arc::new(Remote::s3(url)?), Patience::default());
        Self::over(&client, options, Pace::default())
    }

    pub(in crate::store) fn over(client: &Client, options: &Options, pace: Pace) -> Result<Self, Error> {
        probe(client)?;
        let (cluster, key) = Cluster::join(client, None)?;
        let writer = Uuid::now_v7();
        let mut log = SharedLog::open(client.clone(), SHARD, (cluster.journal, writer), Check::default())?;
        let settings = Settings { lineage: Some(lineage(&cluster, options)), ..options.settings() };
        copy::begin(client, options, (&cluster, &key), log.chain().known())?;
        let backend = local::open(&options.data_dir, options.table, options.cache_bytes)?;
        copy::catch_up(&backend, &settings, cluster.journal, &mut log)?;
        copy::has_key(&backend, &key)?;
        let copy = EmbeddedStore::over(backend, settings)?;
        log.go_to(copy.shared.index.newest() + 1)?;
        let ended = Arc::<AtomicBool>::default();
        let sequencer =
            sequencer::start(copy.shared.clone(), (log, client.clone(), writer), pace, ended.clone())?;
        let chain = Chain::of(client.clone(), SHARD);
        let keeper = keeper::Keeper::new(copy.shared.clone(), (client.clone(), chain, writer), pace);
        let keeping = ended.clone();
        let thread = std::thread::Builder::new().name("keeper".to_owned());
        let keeper = thread.spawn(move || keeper.run(&keeping)).map_err(io_error("starting the keeper"));
        let keeper = keeper.inspect_err(|_| ended.store(true, Ordering::Release))?;
        let mut store = Self { ended, threads: vec![sequencer, keeper], living: None, copy };
        if let Some(address) = options.announce.clone() {
            store.announce((client.clone(), writer), address, pace.announce)?;
        }
        Ok(store)
    }

    /// Tells others where vehicles reach this server, and looks for theirs.
    fn announce(&mut self, bucket: (Client, Uuid), address: String, every: Duration) -> Result<(), Error> {
        let (tell, living) = watch::channel(Vec::new());
        let announcer = announcing::Announcer::new(bucket, address, every, tell);
        let ended = self.ended.clone();
        let thread = std::thread::Builder::new().name("announcer".to_owned());
        let thread = thread.spawn(move || announcer.run(&ended)).map_err(io_error("starting to announce"))?;
        self.threads.push(thread);
        self.living = Some(living);
        Ok(())
    }
}

/// The same for all servers of a cluster that count and publish the same.
fn lineage(cluster: &Cluster, options: &Options) -> u64 {
    SipHasher24::new_with_keys(cluster.lineage, 0).hash(&options.policy.digest().to_le_bytes())
}

impl Drop for ReplicatedStore {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            // It logged its own end.
            let _ = thread.join();
        }
    }
}

impl MapStore for ReplicatedStore {
    fn contributor(&self, pseudonym: &str) -> u64 {
        self.copy.contributor(pseudonym)
    }

    fn lineage(&self) -> u64 {
        self.copy.lineage()
    }

    fn commit(&self, upload: UploadRecord) -> Result<Receipt, Error> {
        self.copy.commit(upload)
    }

    fn counted(&self, id: Uuid) -> Result<Option<Receipt>, Error> {
        self.copy.counted(id)
    }

    fn tile(&self, id: TileId) -> Result<Option<StoredTile>, Error> {
        self.copy.tile(id)
    }

    fn catalog(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Vec<TileInfo>, Error> {
        self.copy.catalog(zone, x, y)
    }

    fn inspect(&self, id: TileId) -> Result<Option<InspectedTile>, Error> {
        self.copy.inspect(id)
    }

    fn withheld(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Option<Withheld>, Error> {
        self.copy.withheld(zone, x, y)
    }

    fn zones(&self) -> Vec<Zone> {
        self.copy.zones()
    }

    fn totals(&self) -> Totals {
        self.copy.totals()
    }

    fn newest_day(&self) -> u16 {
        self.copy.newest_day()
    }

    fn before_serving(&self, prepare: Preparing) {
        self.copy.before_serving(prepare);
    }

    fn progress(&self) -> watch::Receiver<MapProgress> {
        self.copy.progress()
    }

    fn replicas(&self) -> Option<watch::Receiver<Vec<String>>> {
        self.living.clone()
    }

    fn hang(&self) -> Option<String> {
        let over = self.threads.iter().any(JoinHandle::is_finished);
        let ended = || "a thread that follows the bucket has ended; the log says why".to_owned();
        self.copy.hang().or_else(|| over.then(ended))
    }
}

impl Operations for ReplicatedStore {
    fn decide(&self, proposal: &Proposal, remark: &Remark) -> Result<Option<u64>, Error> {
        self.copy.decide(proposal, remark)
    }

    fn preview(&self, proposal: &Proposal) -> Result<Preview, Error> {
        self.copy.preview(proposal)
    }

    fn quarantined(&self) -> Result<Vec<QuarantinedRecord>, Error> {
        self.copy.quarantined()
    }

    fn folding(&self) -> FoldingFigures {
        self.copy.folding()
    }

    fn upload_ids(&self, numbers: &BTreeSet<u64>) -> HashMap<u64, Uuid> {
        self.copy.upload_ids(numbers)
    }

    fn contributors(&self) -> Result<Vec<ContributorFigures>, Error> {
        self.copy.contributors()
    }

    fn uploads_of(&self, hash: u64, before: u64, limit: usize) -> Result<Vec<ContributedUpload>, Error> {
        self.copy.uploads_of(hash, before, limit)
    }

    fn upload(&self, id: Uuid) -> Result<Option<(u64, ContributedUpload)>, Error> {
        self.copy.upload(id)
    }

    fn epochs(&self) -> (u64, u64) {
        self.copy.epochs()
    }

    fn served_at(&self, epoch: u64) -> Result<Arc<dyn MapStore>, Error> {
        self.copy.served_at(epoch)
    }

    fn kept_out(&self) -> broadcast::Receiver<QuarantinedRecord> {
        self.copy.kept_out()
    }

    fn history(&self, limit: usize) -> Vec<HistoryEvent> {
        self.copy.history(limit)
    }

    fn at(&self, epoch: u64) -> Result<Snapshot, Error> {
        self.copy.at(epoch)
    }

    fn export(&self, region: &Region, out: &mut dyn Write) -> Result<u64, Error> {
        self.copy.export(region, out)
    }

    fn import(&self, file: &mut dyn Read) -> Result<Imported, Error> {
        self.copy.import(file)
    }

    fn backup(&self, out: &mut dyn Write) -> Result<u64, Error> {
        self.copy.backup(out)
    }

    fn verify(&self, replay: bool) -> Result<Verified, Error> {
        self.copy.verify(replay)
    }

    fn wind_down(&self) {
        self.copy.wind_down();
    }
}
