//! The thread by which replicas know each other: each announces the address at which vehicles reach it, again and again,
//! and believes that others live for as long as it sees them do so. It tells vehicles where they are better asked; nothing of the
//! map rests on it.
//!
//! An announcement is an object of a new name each time, so that a list alone shows who goes on. Who lives is judged by the
//! reader's own clock.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use uuid::Uuid;

use super::SHARD;
use crate::store::api::Error;
use crate::store::object::body;
use crate::store::object::client::Client;
use crate::store::object::names::announced;

const MAGIC: [u8; 4] = *b"EFN\x01";
/// How often it is looked whether the end was called.
const TICK: Duration = Duration::from_millis(50);
/// Who has announced nothing for so many turns is gone.
const MISSED: u32 = 3;
/// What nobody renewed for so many turns is deleted by whoever sees it.
const LEFT: u32 = 60;

/// Another replica, as it was seen last.
struct Seen {
    /// Its newest announcement, and since when it is the newest.
    number: u64,
    since: Instant,
    /// Has it announced itself since this one began to look? What was left by one that is gone stays as it is.
    goes_on: bool,
    /// `None` where it cannot be read.
    address: Option<String>,
}

pub(super) struct Announcer {
    client: Client,
    writer: Uuid,
    address: String,
    every: Duration,
    number: u64,
    seen: HashMap<Uuid, Seen>,
    living: watch::Sender<Vec<String>>,
}

impl Announcer {
    /// One that announces an address so often, and tells `living` the addresses of all that live, its own among them.
    pub(super) fn new(
        (client, writer): (Client, Uuid),
        address: String,
        every: Duration,
        living: watch::Sender<Vec<String>>,
    ) -> Self {
        living.send_replace(vec![address.clone()]);
        Self { client, writer, address, every, number: 0, seen: HashMap::new(), living }
    }

    pub(super) fn run(mut self, ended: &AtomicBool) {
        let mut last: Option<Instant> = None;
        while !ended.load(Ordering::Acquire) {
            if last.is_none_or(|last| last.elapsed() >= self.every) {
                last = Some(Instant::now());
                if let Err(error) = self.turn() {
                    tracing::debug!(%error, "could not see which other services live");
                }
                self.tell();
            }
            std::thread::sleep(TICK.min(self.every));
        }
        // Without it, others find out by themselves.
        let _ = self.client.bucket().delete(&SHARD.announcement(self.writer, self.number));
    }

    fn turn(&mut self) -> Result<(), Error> {
        let before = self.number;
        self.number += 1;
        let body = body::wrap(MAGIC, self.address.as_bytes());
        self.client.put_new(&SHARD.announcement(self.writer, self.number), &body)?;
        if before > 0 {
            self.client.delete(&SHARD.announcement(self.writer, before))?;
        }
        for listed in self.client.list(&SHARD.announcements())? {
            match announced(&listed.name) {
                Some((writer, number)) if writer != self.writer => self.see(&listed.name, writer, number)?,
                _ => {}
            }
        }
        self.forget()
    }

    fn see(&mut self, name: &str, writer: Uuid, number: u64) -> Result<(), Error> {
        if let Some(seen) = self.seen.get_mut(&writer) {
            // A list may be old.
            if number > seen.number {
                *seen = Seen { number, since: Instant::now(), goes_on: true, address: seen.address.take() };
            }
            return Ok(());
        }
        // It was replaced meanwhile: the next list has the newer one.
        let Some(bytes) = self.client.get(name)? else { return Ok(()) };
        let content = body::unwrap(MAGIC, &bytes).map(<[u8]>::to_vec);
        let address = content.and_then(|content| String::from_utf8(content).ok());
        if address.is_none() {
            tracing::warn!(
                name = self.client.locate(name),
                "an announcement is damaged, or of another version"
            );
        }
        self.seen.insert(writer, Seen { number, since: Instant::now(), goes_on: false, address });
        Ok(())
    }

    /// Deletes what nobody renews.
    fn forget(&mut self) -> Result<(), Error> {
        let left = self.every * LEFT;
        let old: Vec<_> = self
            .seen
            .iter()
            .filter(|(_, seen)| seen.since.elapsed() > left)
            .map(|(writer, seen)| (*writer, seen.number))
            .collect();
        for (writer, number) in old {
            self.client.delete(&SHARD.announcement(writer, number))?;
            self.seen.remove(&writer);
        }
        Ok(())
    }

    fn tell(&self) {
        let lives = |seen: &&Seen| seen.goes_on && seen.since.elapsed() < self.every * MISSED;
        let others = self.seen.values().filter(lives).filter_map(|seen| seen.address.clone());
        let mut living: Vec<_> = others.chain([self.address.clone()]).collect();
        living.sort();
        living.dedup();
        self.living.send_if_modified(|known| {
            let changed = *known != living;
            if changed {
                tracing::info!(replicas = living.join(" "), "these services share the map");
                *known = living;
            }
            changed
        });
    }
}
