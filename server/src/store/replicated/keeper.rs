//! The thread that publishes what was compacted, and deletes what is no longer needed. Any server may do it at any time, and
//! several at once: one manifest wins, the others throw their packs away. That they seldom do comes of waiting in turns.

use std::hash::Hasher as _;
use std::io::Read as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use siphasher::sip::SipHasher24;
use uuid::Uuid;

use super::{Pace, SHARD};
use crate::store::api::{Error, io_error};
use crate::store::backend::objects::reader;
use crate::store::map::context::StoreContext;
use crate::store::object::chain::Chain;
use crate::store::object::client::{Client, Put};
use crate::store::object::collect::{Swept, sweep};
use crate::store::object::manifest::Manifest;
use crate::store::object::shared_log::{Check, SharedLog};

/// How often it is looked whether the end was called.
const TICK: Duration = Duration::from_millis(50);
/// Turns that servers wait in, of a pace each.
const TURNS: u64 = 4;

pub(super) struct Keeper {
    shared: Arc<StoreContext>,
    client: Client,
    chain: Chain,
    writer: Uuid,
    pace: Pace,
    /// The manifest that is due, and since when it was seen to be.
    due: Option<(u64, Instant)>,
    swept: Option<Instant>,
}

impl Keeper {
    pub(super) fn new(
        shared: Arc<StoreContext>,
        (client, chain, writer): (Client, Chain, Uuid),
        pace: Pace,
    ) -> Self {
        Self { shared, client, chain, writer, pace, due: None, swept: None }
    }

    pub(super) fn run(mut self, ended: &AtomicBool) {
        let mut last = Instant::now();
        while !ended.load(Ordering::Acquire) {
            std::thread::sleep(TICK.min(self.pace.keep));
            if last.elapsed() < self.pace.keep {
                continue;
            }
            if let Err(error) = self.keep() {
                tracing::warn!(%error, "what was compacted could not be published or deleted in the bucket; trying again");
            }
            last = Instant::now();
        }
    }

    fn keep(&mut self) -> Result<(), Error> {
        let published = self.chain.newest()?.clone();
        let last = self.shared.checkpoint().last;
        if last + 1 > published.next && self.is_our_turn(published.epoch + 1) && self.publish(last)? {
            self.swept = None;
        }
        // Once for as long as what is deleted must be old.
        if self.swept.is_none_or(|at| at.elapsed() >= self.pace.age) {
            let now_us = self.shared.settings.clock.now_us();
            let Swept { segments, packs, .. } =
                sweep(&self.client, SHARD, self.chain.known(), (now_us, self.pace.age))?;
            if segments + packs > 0 {
                tracing::info!(segments, packs, "deleted what was compacted from the bucket");
            }
            self.swept = Some(Instant::now());
        }
        Ok(())
    }

    /// A server whose turn comes later most likely finds the work done. It saves work; nothing rests on it.
    fn is_our_turn(&mut self, epoch: u64) -> bool {
        let since = match self.due {
            Some((due, since)) if due == epoch => since,
            _ => {
                let now = Instant::now();
                self.due = Some((epoch, now));
                now
            }
        };
        let mut hasher = SipHasher24::new();
        hasher.write(self.writer.as_bytes());
        hasher.write_u64(epoch);
        let turn = hasher.finish() % TURNS;
        since.elapsed() >= self.pace.keep * turn as u32
    }

    /// Publishes the checkpoint; false when another server was faster.
    fn publish(&mut self, at_least: u64) -> Result<bool, Error> {
        let epoch = self.chain.known().epoch + 1;
        let (last, bytes) = self.checkpoint()?;
        if last < at_least {
            return Ok(false);
        }
        let pack = SHARD.pack(epoch, Uuid::now_v7());
        if self.client.put_new(&pack, &bytes)? != Put::Ours {
            return Ok(false);
        }
        let journal = (self.shared.journal_id, self.writer);
        let mut log = SharedLog::open(self.client.clone(), SHARD, journal, Check::default())?;
        log.go_to(last + 1)?;
        let (floor, first) = (log.next().seq, log.next().number);
        let owner = self.writer;
        let manifest = Manifest { epoch, owner, floor, first, pack: Some(pack), next: last + 1 };
        let published = self.chain.publish(manifest)?;
        if published {
            tracing::info!(epoch, last, floor, "published what was compacted");
        }
        Ok(published)
    }

    fn checkpoint(&self) -> Result<(u64, Vec<u8>), Error> {
        let checkpoint = self.shared.checkpoint();
        let Some(name) = &checkpoint.name else { return Ok((0, Vec::new())) };
        let mut bytes = Vec::new();
        let opened = self.shared.backend.objects.open(name).and_then(reader);
        let read = opened.and_then(|mut reader| reader.read_to_end(&mut bytes));
        read.map_err(io_error("reading the checkpoint"))?;
        Ok((checkpoint.last, bytes))
    }
}
