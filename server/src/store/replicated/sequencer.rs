//! The thread that follows the shared journal: what others wrote comes into this server's own, and what is to be written is
//! appended to it, one segment for all that wait.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use uuid::Uuid;

use super::{Pace, SHARD, copy};
use crate::store::api::{Error, io_error};
use crate::store::log::entry::RecordSubject;
use crate::store::log::position::Written;
use crate::store::log::sequencer::{NewRecord, Sequenced, Sequencer};
use crate::store::map::context::StoreContext;
use crate::store::object::client::Client;
use crate::store::object::shared_log::{Appended, Peeked, SharedLog};

/// Bytes of one segment, but for a single larger submission.
const SEGMENT_BYTES: usize = 8 << 20;
/// Polls that found nothing after which it is looked whether the floor has passed.
const IDLE: u32 = 20;

/// Records that wait to be written together.
struct Submission {
    records: Vec<NewRecord>,
    done: SyncSender<Result<Vec<Sequenced>, Error>>,
}

impl Submission {
    fn bytes(&self) -> usize {
        self.records.iter().map(|record| record.payload.len()).sum()
    }
}

struct Handle(Mutex<Sender<Submission>>);

impl Sequencer for Handle {
    fn sequence(&self, records: Vec<NewRecord>) -> Result<Vec<Sequenced>, Error> {
        let gone = || Error::Stopped("the thread that follows the bucket has ended".to_owned());
        let (done, outcome) = mpsc::sync_channel(1);
        let sender = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        sender.send(Submission { records, done }).map_err(|_| gone())?;
        outcome.recv().map_err(|_| gone())?
    }
}

/// Starts the thread; from now on the journal's submissions go through it.
pub(super) fn start(
    shared: Arc<StoreContext>,
    (log, client, writer): (SharedLog, Client, Uuid),
    pace: Pace,
    ended: Arc<AtomicBool>,
) -> Result<JoinHandle<()>, Error> {
    let (sender, receiver) = mpsc::channel();
    shared.journal.follow(Box::new(Handle(Mutex::new(sender))));
    let follower = Follower { shared, log, client, writer, pace, idle: 0, refusing: None };
    let thread = std::thread::Builder::new().name("sequencer".to_owned());
    thread.spawn(move || follower.run(&receiver, &ended)).map_err(io_error("starting to follow the bucket"))
}

struct Follower {
    shared: Arc<StoreContext>,
    log: SharedLog,
    client: Client,
    writer: Uuid,
    pace: Pace,
    idle: u32,
    /// Why nothing can be written for the moment.
    refusing: Option<String>,
}

impl Follower {
    fn run(mut self, receiver: &Receiver<Submission>, ended: &AtomicBool) {
        let mut held = None;
        while !ended.load(Ordering::Acquire) {
            let first = match held.take() {
                Some(first) => Ok(first),
                None => receiver.recv_timeout(self.pace.poll),
            };
            let outcome = match first {
                Ok(first) => {
                    let group = gathered(first, receiver, &mut held);
                    self.answer(group)
                }
                Err(RecvTimeoutError::Timeout) => self.idle(),
                Err(RecvTimeoutError::Disconnected) => return,
            };
            match outcome {
                Ok(()) => self.takes(None),
                Err(Error::Stopped(reason)) => {
                    tracing::error!(reason, "the journal stopped accepting writes");
                    self.shared.note_stop(&Error::Stopped(reason));
                    return;
                }
                Err(error) => self.takes(Some(error.to_string())),
            }
        }
    }

    /// Tells whether uploads can be written.
    fn takes(&mut self, refusing: Option<String>) {
        let before = self.refusing.is_some();
        match &refusing {
            Some(reason) if !before => {
                tracing::error!(reason, "the bucket cannot be used; it is tried again");
            }
            None if before => tracing::info!("the bucket can be used again"),
            _ => {}
        }
        let now = refusing.is_some();
        self.refusing = refusing;
        if before != now {
            self.shared.progress.send_modify(|progress| progress.refusing = now);
        }
    }

    /// Nothing waits to be written. Nobody sends uploads to a server that is not ready for them, so after a failure it is
    /// tried here whether the bucket takes anything.
    fn idle(&mut self) -> Result<(), Error> {
        if self.refusing.is_some() {
            self.client.tries_once(&SHARD.trial(self.writer))?;
        }
        let stood = self.log.next();
        self.follow()?;
        self.idle = if self.log.next() == stood { self.idle + 1 } else { 0 };
        if self.idle >= IDLE {
            self.idle = 0;
            if self.log.is_passed()? {
                return Err(copy::passed());
            }
        }
        Ok(())
    }

    /// Reads the shared journal to its end.
    fn follow(&mut self) -> Result<(), Error> {
        loop {
            match self.log.peek()? {
                Peeked::Nothing => return Ok(()),
                Peeked::Passed => return Err(copy::passed()),
                Peeked::Segment(segment) => {
                    copy::write(&self.shared.journal, &segment, self.shared.index.newest())?;
                    self.log.advance(&segment);
                }
            }
        }
    }

    /// Writes a group, and tells those who wait for it.
    fn answer(&mut self, group: Vec<Submission>) -> Result<(), Error> {
        if let Some(reason) = &self.refusing {
            // They are told at once, and the bucket is tried meanwhile.
            let refused =
                || io_error("writing to the bucket")(io::Error::new(io::ErrorKind::TimedOut, reason.clone()));
            for submission in group {
                let _ = submission.done.send(Err(refused()));
            }
            return self.idle();
        }
        match self.write(&group) {
            Ok(outcomes) => {
                for (submission, outcome) in group.into_iter().zip(outcomes) {
                    // A caller that went away learns it from its own retry.
                    let _ = submission.done.send(Ok(outcome));
                }
                Ok(())
            }
            Err(error) => {
                for submission in group {
                    let _ = submission.done.send(Err(copied(&error)));
                }
                Err(error)
            }
        }
    }

    /// Appends what of a group is not in the journal yet. It is known once all before it was read.
    fn write(&mut self, group: &[Submission]) -> Result<Vec<Vec<Sequenced>>, Error> {
        loop {
            let known: Vec<Vec<_>> = group
                .iter()
                .map(|one| one.records.iter().map(|record| self.known(record)).collect())
                .collect();
            let records = || group.iter().zip(&known).flat_map(|(one, known)| one.records.iter().zip(known));
            let new = records().filter(|(_, known)| known.is_none());
            let new: Vec<_> = new.map(|(record, _)| record.payload.clone()).collect();
            let mut next = self.log.next().number..;
            if !new.is_empty() {
                match self.log.append(new)? {
                    Appended::Written(segment) => {
                        copy::write(&self.shared.journal, &segment, self.shared.index.newest())?;
                        self.log.advance(&segment);
                    }
                    Appended::Behind => {
                        self.follow()?;
                        continue;
                    }
                    Appended::Passed => return Err(copy::passed()),
                }
            }
            let mut sequenced = |known: Option<Written>| {
                if let Some(written) = known {
                    return Ok(Sequenced { written, known: true });
                }
                let written = next.next().and_then(|number| self.shared.index.get(number));
                let lost = || Error::Stopped("a record that was written is not in the index".to_owned());
                Ok(Sequenced { written: written.ok_or_else(lost)?, known: false })
            };
            return known.into_iter().map(|one| one.into_iter().map(&mut sequenced).collect()).collect();
        }
    }

    /// Where a record is that another server, or a call whose outcome was not known, has written.
    fn known(&self, record: &NewRecord) -> Option<Written> {
        match record.meta.what {
            RecordSubject::Upload { id, .. } => self.shared.index.find(id),
            RecordSubject::Import { file, tile } => self.shared.index.find_import(file, tile),
            RecordSubject::Control(_) => None,
        }
    }
}

/// All that waits and fits into one segment.
fn gathered(
    first: Submission,
    receiver: &Receiver<Submission>,
    held: &mut Option<Submission>,
) -> Vec<Submission> {
    let mut bytes = first.bytes();
    let mut group = vec![first];
    while let Ok(next) = receiver.try_recv() {
        bytes += next.bytes();
        if bytes > SEGMENT_BYTES {
            *held = Some(next);
            break;
        }
        group.push(next);
    }
    group
}

/// An `io::Error` cannot be cloned; its kind and message are what matters.
fn copied(error: &Error) -> Error {
    match error {
        Error::Stopped(reason) => Error::Stopped(reason.clone()),
        Error::Io { doing, source } => {
            Error::Io { doing, source: io::Error::new(source.kind(), source.to_string()) }
        }
        other => io_error("writing to the bucket")(io::Error::other(other.to_string())),
    }
}
