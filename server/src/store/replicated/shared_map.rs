//! What operators see of a map in a bucket, without a service: is it sound, what is in it, what can go. And the way of a data
//! directory into an empty bucket.

use std::io::Read as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use serde::Serialize;
use uuid::Uuid;

use super::{Pace, SHARD};
use crate::store::api::{Error, StoreClock, Verified, io_error};
use crate::store::backend::Backend;
use crate::store::backend::objects::reader;
use crate::store::backend::owner::KEY;
use crate::store::local::{self, TableEngine};
use crate::store::log::entry;
use crate::store::log::journal::Journal;
use crate::store::map::checkpoint::{self, Checkpoint};
use crate::store::object::client::{Client, Patience, Put};
use crate::store::object::cluster::Cluster;
use crate::store::object::collect::sweep;
use crate::store::object::manifest::Manifest;
use crate::store::object::probe::probe;
use crate::store::object::remote::Remote;
use crate::store::object::shared_log::{Appended, Check, Peeked, SharedLog};

/// Bytes of a segment that records are brought in.
const SEGMENT_BYTES: usize = 8 << 20;

/// A map in a bucket. Every call waits for the store: keep it off the async threads.
pub struct SharedMap {
    client: Client,
    writer: Uuid,
}

/// What is in a bucket.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SharedMapStatus {
    /// The journal's id.
    pub journal: Uuid,
    /// Parts that the map is divided into.
    pub shards: u32,
    /// The newest manifest; 0 before the first.
    pub manifest: u64,
    /// The first segment that is needed.
    pub floor: u64,
    /// The last record that was compacted.
    pub compacted: u64,
    /// The last record.
    pub newest: u64,
    /// Segments that are stored, and their bytes.
    pub segments: u64,
    /// See `segments`.
    pub segment_bytes: u64,
    /// Segments below the floor, and packs that no manifest names: a sweep deletes them once they are old.
    pub orphans: u64,
}

impl SharedMap {
    /// The map of `s3://bucket/prefix`, see [`super::ReplicatedStore::open`]. Nothing is asked yet.
    ///
    /// # Errors
    /// When the URL or the environment does not do.
    pub fn at(url: &str) -> Result<Self, Error> {
        Ok(Self::over(Client::new(Arc::new(Remote::s3(url)?), Patience::default())))
    }

    pub(in crate::store) fn over(client: Client) -> Self {
        Self { client, writer: Uuid::now_v7() }
    }

    /// Does the store keep conditions? Every service asks the same when it starts.
    ///
    /// # Errors
    /// When it does not, or does not answer.
    pub fn probe(&self) -> Result<(), Error> {
        probe(&self.client)
    }

    fn cluster(&self) -> Result<Cluster, Error> {
        let none = || Error::Unknown(format!("there is no map at {}", self.client.locate("")));
        Cluster::found(&self.client)?.ok_or_else(none)
    }

    fn log(&self, cluster: &Cluster) -> Result<SharedLog, Error> {
        SharedLog::open(self.client.clone(), SHARD, (cluster.journal, self.writer), Check::default())
    }

    /// What is in it.
    ///
    /// # Errors
    /// When there is no map, the store does not answer, or what it holds is damaged.
    pub fn status(&self) -> Result<SharedMapStatus, Error> {
        let cluster = self.cluster()?;
        let mut log = self.log(&cluster)?;
        let newest = log.go_to_end()?.number - 1;
        let manifest = log.chain().known().clone();
        let segments = self.client.list(&SHARD.journal())?;
        let needed = |name: &String| *name >= SHARD.segment(manifest.floor);
        let packs = self.client.list(&SHARD.packs())?;
        let stray = packs.iter().filter(|pack| Some(&pack.name) != manifest.pack.as_ref()).count();
        let below = segments.iter().filter(|segment| !needed(&segment.name)).count();
        Ok(SharedMapStatus {
            journal: cluster.journal,
            shards: cluster.shards,
            manifest: manifest.epoch,
            floor: manifest.floor,
            compacted: manifest.next - 1,
            newest,
            segments: segments.len() as u64,
            segment_bytes: segments.iter().map(|segment| segment.bytes).sum(),
            orphans: (below + stray) as u64,
        })
    }

    /// Deletes what no longer counts and is older than an hour; returns how many objects that were.
    ///
    /// # Errors
    /// When there is no map, or the store does not answer.
    pub fn sweep(&self) -> Result<u64, Error> {
        self.sweep_older(Pace::default().age)
    }

    pub(in crate::store) fn sweep_older(&self, age: Duration) -> Result<u64, Error> {
        let cluster = self.cluster()?;
        let manifest = self.log(&cluster)?.chain().known().clone();
        let swept = sweep(&self.client, SHARD, &manifest, (StoreClock::default().now_us(), age))?;
        Ok(swept.segments + swept.packs)
    }

    /// Reads all that counts: the newest manifest, its pack, and every segment behind it.
    ///
    /// # Errors
    /// When there is no map, or the store does not answer. Damage is an answer, not an error.
    pub fn verify(&self) -> Result<Verified, Error> {
        let cluster = self.cluster()?;
        let mut log = self.log(&cluster)?;
        let manifest = log.chain().known().clone();
        let mut found = Verified::default();
        if let Some(name) = &manifest.pack {
            let checked = match self.client.get(name)? {
                Some(pack) => checkpoint::checked(name, &pack),
                None => Err(Error::Damaged { what: name.clone(), reason: "it is gone".to_owned() }),
            };
            match checked {
                Ok((journal, last, tiles)) if (journal, last + 1) == (cluster.journal, manifest.next) => {
                    found.checkpoint_tiles = tiles;
                }
                Ok(_) => found.damage.push(format!("{name} is of another journal, or of another time")),
                Err(error) => found.damage.push(error.to_string()),
            }
        }
        loop {
            match log.peek() {
                Ok(Peeked::Nothing) => return Ok(found),
                Ok(Peeked::Passed) => {
                    return Err(Error::Unknown("it was compacted meanwhile; ask again".to_owned()));
                }
                Ok(Peeked::Segment(segment)) => {
                    for (number, record) in (segment.first..).zip(&segment.records) {
                        found.records += 1;
                        if entry::decode(record).is_none() {
                            found.damage.push(format!("record {number} cannot be read"));
                        }
                    }
                    log.advance(&segment);
                }
                Err(error @ Error::Damaged { .. }) => {
                    found.damage.push(error.to_string());
                    return Ok(found);
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Brings the map of a data directory, which no service uses, into a bucket that holds none: its key, its checkpoint and
    /// every record under its number; returns the last. Done again after a failure it goes on. The directory stays as it is.
    ///
    /// # Errors
    /// When the directory is in use or damaged, the bucket holds another map, or the store does not answer.
    pub fn migrate(&self, data_dir: &Path) -> Result<u64, Error> {
        self.probe()?;
        if !local::seed::is_begun(data_dir)? {
            return Err(Error::Unusable(format!("{} holds no map", data_dir.display())));
        }
        let backend = local::open(data_dir, TableEngine::default(), 1 << 20)?;
        let key = key(&backend)?;
        let listed = backend.segments.list().map_err(io_error("listing the journal"))?;
        let first = listed.first().map_or(1, |segment| segment.first);
        let mut records = Vec::new();
        let mut outcome = Outcome { mover: None, bytes: 0 };
        // The journal's id is known once it was read: nothing is brought in before all of it is known to be sound.
        let found = Journal::recover(&*backend.segments, |_, _| Ok(()))?;
        let (cluster, kept) = Cluster::join(&self.client, Some((found.id(), key)))?;
        if (cluster.journal, kept) != (found.id(), key) {
            return Err(Error::Unusable(format!("{} holds another map", self.client.locate(""))));
        }
        let mut log = self.log(&cluster)?;
        self.publish_checkpoint(&backend, &mut log, found.id(), first)?;
        let next = log.go_to_end()?.number;
        outcome.mover = Some(log);
        Journal::recover(&*backend.segments, |written, payload| {
            if written.number < next {
                return Ok(());
            }
            outcome.bytes += payload.len();
            records.push(payload.to_vec());
            if outcome.bytes < SEGMENT_BYTES { Ok(()) } else { outcome.flush(&mut records) }
        })?;
        outcome.flush(&mut records)?;
        Ok(found.end())
    }

    /// Without a checkpoint nothing needs to be published: the journal begins with its first record.
    fn publish_checkpoint(
        &self,
        backend: &Backend,
        log: &mut SharedLog,
        journal: Uuid,
        first: u64,
    ) -> Result<(), Error> {
        let checkpoint = Checkpoint::newest(&*backend.objects, journal)?;
        let Some(name) = &checkpoint.name else { return Ok(()) };
        if log.chain().known().epoch > 0 {
            return Ok(());
        }
        let mut bytes = Vec::new();
        let opened = backend.objects.open(name).and_then(reader);
        opened
            .and_then(|mut reader| reader.read_to_end(&mut bytes))
            .map_err(io_error("reading the checkpoint"))?;
        let pack = SHARD.pack(1, Uuid::now_v7());
        let other = || Error::Unusable(format!("another server uses {} already", self.client.locate("")));
        if self.client.put_new(&pack, &bytes)? != Put::Ours {
            return Err(other());
        }
        let (next, owner) = (checkpoint.last + 1, self.writer);
        let manifest = Manifest { epoch: 1, owner, floor: 1, first, pack: Some(pack), next };
        if log.chain().publish(manifest)? { Ok(()) } else { Err(other()) }
    }
}

struct Outcome {
    mover: Option<SharedLog>,
    bytes: usize,
}

impl Outcome {
    /// Brings in what was gathered.
    fn flush(&mut self, records: &mut Vec<Vec<u8>>) -> Result<(), Error> {
        self.bytes = 0;
        let Some(log) = self.mover.as_mut().filter(|_| !records.is_empty()) else { return Ok(()) };
        match log.append(std::mem::take(records))? {
            Appended::Written(segment) => {
                log.advance(&segment);
                Ok(())
            }
            Appended::Behind | Appended::Passed => Err(Error::Unusable(
                "a service uses the bucket already; end it, and begin with an empty one".to_owned(),
            )),
        }
    }
}

/// The key that a directory's contributors are hashed with.
fn key(backend: &Backend) -> Result<[u8; 16], Error> {
    let mut bytes = Vec::new();
    let opened = backend.objects.open(KEY).and_then(reader);
    opened.and_then(|mut reader| reader.read_to_end(&mut bytes)).map_err(io_error("reading the key"))?;
    // Opening the directory has brought it into its checksummed form.
    bytes
        .last_chunk::<16>()
        .copied()
        .ok_or_else(|| Error::Damaged { what: "the key".to_owned(), reason: "it is too short".to_owned() })
}
