//! The thread that writes: one sync for all appends that wait.

use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::Duration;

use tracing::Span;

use super::entry::RecordMeta;
use super::faults::{Fault, fault};
use super::medium::LogSegment;
use super::position::{RecordPosition, Written};
use super::segment::{self, RECORD_HEADER};
use crate::store::api::Error;

/// Bytes written with one sync at most, but for a single larger record.
const GROUP_BYTES: usize = 8 << 20;

/// A record that waits to be written.
pub(in crate::store) struct Append {
    pub(in crate::store) meta: RecordMeta,
    /// Begins a segment of its own.
    pub(in crate::store) fresh: bool,
    pub(in crate::store) payload: Vec<u8>,
    /// See [`NewRecord::number`](super::sequencer::NewRecord::number).
    pub(in crate::store) number: Option<u64>,
    /// The span of the caller, for what is logged about its record.
    pub(super) span: Span,
    /// Where the caller waits for the outcome.
    pub(in crate::store) done: SyncSender<Result<Written, Error>>,
}

/// Gets every record once it is on disk.
type Deliver = Box<dyn FnMut(RecordMeta, Written) + Send>;
/// Is told when the disk begins to refuse writes, and when it takes them again.
type Refusing = Box<dyn FnMut(bool) + Send>;

/// How often a disk that refused is tried again, if nobody else tries it.
const PROBE: Duration = Duration::from_secs(2);
/// Bytes that it must take then.
const PROBE_BYTES: usize = 1 << 20;

/// What the writer asks of the disk.
pub(in crate::store) struct Disk {
    /// Makes the segment whose first record has this number.
    pub(in crate::store) create: Box<dyn FnMut(u64) -> Result<LogSegment, Error> + Send>,
    /// Did nobody else take the directory over? Asked after each sync, see [`crate::store::backend::owner::Fence`].
    pub(super) still_ours: Box<dyn Fn() -> Result<(), Error> + Send>,
}

pub(super) struct JournalWriter {
    disk: Disk,
    /// `None` before the first record, and when it is not known what the file holds: then the next record begins another.
    segment: Option<LogSegment>,
    /// A segment without an acknowledged record, of which it is not known what it holds: it is cut before it is used.
    suspect: Option<LogSegment>,
    /// Number of the next record.
    next: u64,
    /// Day the newest record was written on.
    day: Option<u16>,
    segment_bytes: u64,
    deliver: Deliver,
    refusing: Refusing,
    /// The disk refused the last write.
    refused: bool,
    /// Why nothing is accepted any more.
    stopped: Option<String>,
}

/// Why a group is not on disk, or must not be acknowledged.
enum WriteFailure {
    /// The next group may succeed.
    Refused(io::Error),
    /// Another server has the directory.
    Fenced(String),
}

impl JournalWriter {
    pub(in crate::store) fn new(
        disk: Disk,
        (next, segment): (u64, Option<LogSegment>),
        segment_bytes: u64,
        (deliver, refusing): (Deliver, Refusing),
    ) -> Self {
        Self {
            disk,
            segment,
            suspect: None,
            next,
            day: None,
            segment_bytes,
            deliver,
            refusing,
            refused: false,
            stopped: None,
        }
    }

    /// Writes until every sender is gone.
    pub(in crate::store) fn run(mut self, receiver: &Receiver<Append>) {
        let mut held = None;
        while let Some(first) = held.take().or_else(|| self.next_append(receiver)) {
            let (mut bytes, day) = (first.payload.len(), first.meta.day);
            let mut group = vec![first];
            while bytes < GROUP_BYTES
                && let Ok(append) = receiver.try_recv()
            {
                if append.fresh || append.meta.day != day {
                    held = Some(append);
                    break;
                }
                bytes += append.payload.len();
                group.push(append);
            }
            self.commit(group);
        }
    }

    /// Waits for an append. A disk that refused is tried meanwhile: nobody sends uploads to a service that is not ready for
    /// them, and so nothing else would tell that it is again.
    fn next_append(&mut self, receiver: &Receiver<Append>) -> Option<Append> {
        while self.refused && self.stopped.is_none() {
            match receiver.recv_timeout(PROBE) {
                Ok(append) => return Some(append),
                Err(RecvTimeoutError::Disconnected) => return None,
                Err(RecvTimeoutError::Timeout) => {
                    if self.probe().is_ok() {
                        tracing::info!("the journal can be written again");
                        self.takes(true);
                    }
                }
            }
        }
        receiver.recv().ok()
    }

    /// Does the disk take what a large upload has? A segment without a record remains, for the next one.
    fn probe(&mut self) -> Result<(), WriteFailure> {
        let mut segment = match self.segment.take() {
            Some(segment) if segment.is_empty() => segment,
            _ => self.begun()?,
        };
        let tried = segment.medium.append(&vec![0; PROBE_BYTES]).and_then(|()| segment.medium.sync());
        let outcome = tried.and_then(|()| segment.medium.cut(segment.length));
        match &outcome {
            Ok(()) => self.segment = Some(segment),
            Err(_) => self.suspect = Some(segment),
        }
        outcome.map_err(WriteFailure::Refused)
    }

    fn takes(&mut self, takes: bool) {
        if self.refused == takes {
            self.refused = !takes;
            (self.refusing)(!takes);
        }
    }

    /// Writes a group, syncs it, and only then answers.
    fn commit(&mut self, group: Vec<Append>) {
        if fault() == Some(Fault::AckBeforeWrite) {
            // As one that writes now and then.
            std::thread::sleep(Duration::from_millis(20));
        }
        let written = match &self.stopped {
            Some(reason) => Err(WriteFailure::Fenced(reason.clone())),
            None if self.misses(&group) => {
                Err(WriteFailure::Refused(io::Error::other("the record before it is not written")))
            }
            None => self.segment_for(&group[0]).and_then(|segment| self.write(segment, &group)),
        };
        match written {
            Ok(written) => {
                self.takes(true);
                for (append, written) in group.into_iter().zip(written) {
                    self.day = Some(append.meta.day);
                    (self.deliver)(append.meta, written);
                    // A caller that went away learns it from its own retry.
                    let _ = append.done.send(Ok(written));
                }
            }
            Err(failure) => self.refuse(group, &failure),
        }
    }

    /// Would a record of a group get another number than the one that it has elsewhere?
    fn misses(&self, group: &[Append]) -> bool {
        group.iter().zip(self.next..).any(|(append, next)| append.number.is_some_and(|number| number != next))
    }

    fn refuse(&mut self, group: Vec<Append>, failure: &WriteFailure) {
        match failure {
            WriteFailure::Refused(error) => {
                if !self.refused {
                    tracing::error!(%error, "the journal could not be written; it is tried again");
                }
                self.takes(false);
            }
            WriteFailure::Fenced(reason) if self.stopped.is_none() => {
                tracing::error!(reason, "the journal stopped accepting writes");
                self.stopped = Some(reason.clone());
            }
            WriteFailure::Fenced(_) => {}
        }
        for append in group {
            let error = match failure {
                WriteFailure::Refused(error) => {
                    // An `io::Error` cannot be cloned; its kind and message are what matters.
                    let source = io::Error::new(error.kind(), error.to_string());
                    Error::Io { doing: "writing the journal", source }
                }
                WriteFailure::Fenced(reason) => Error::Stopped(reason.clone()),
            };
            append.span.in_scope(|| tracing::debug!("a record was not written"));
            let _ = append.done.send(Err(error));
        }
    }

    /// The segment to write to: a new one when there is none, or the current one is full or of another day. It is taken out;
    /// what is known to be sound is put back.
    fn segment_for(&mut self, first: &Append) -> Result<LogSegment, WriteFailure> {
        let another_day = self.day.is_some_and(|day| day != first.meta.day);
        if let Some(segment) = self.segment.take() {
            let full = segment.length >= self.segment_bytes;
            if !full && (segment.first == self.next || !(another_day || first.fresh)) {
                return Ok(segment);
            }
        }
        self.begun()
    }

    /// A new segment. The one before is never written to again; where this fails, the next group tries again.
    fn begun(&mut self) -> Result<LogSegment, WriteFailure> {
        if let Some(mut suspect) = self.suspect.take().filter(|suspect| suspect.first == self.next) {
            return match suspect.medium.cut(suspect.length) {
                Ok(()) => Ok(suspect),
                Err(error) => {
                    self.suspect = Some(suspect);
                    Err(WriteFailure::Refused(error))
                }
            };
        }
        (self.disk.create)(self.next).map_err(|error| match error {
            Error::Io { source, .. } => WriteFailure::Refused(source),
            Error::Stopped(reason) => WriteFailure::Fenced(reason),
            other => WriteFailure::Refused(io::Error::other(other.to_string())),
        })
    }

    /// Writes a group to a segment, which is kept for the next one. After a failure that leaves it unknown what the file holds,
    /// it is given up: the next segment begins with the number that this group was to have, so that what may be left of it
    /// does not count. One without a record is cut instead, before it is used again.
    fn write(&mut self, mut segment: LogSegment, group: &[Append]) -> Result<Vec<Written>, WriteFailure> {
        match self.try_to_write(&mut segment, group) {
            Ok(written) => {
                self.segment = Some(segment);
                Ok(written)
            }
            Err((failure, whole)) => {
                let suspect = !whole && segment.is_empty();
                *(if suspect { &mut self.suspect } else { &mut self.segment }) =
                    (whole || suspect).then_some(segment);
                Err(failure)
            }
        }
    }

    /// The outcome; with a failure, whether the segment is whole all the same.
    fn try_to_write(
        &mut self,
        segment: &mut LogSegment,
        group: &[Append],
    ) -> Result<Vec<Written>, (WriteFailure, bool)> {
        let synced = self.next - 1;
        let mut bytes = Vec::with_capacity(group.iter().map(|a| RECORD_HEADER + a.payload.len()).sum());
        let mut written = Vec::with_capacity(group.len());
        for (number, append) in (self.next..).zip(group) {
            let offset = segment.length + (bytes.len() + RECORD_HEADER) as u64;
            segment::put_record(&mut bytes, number, synced, &append.payload);
            let length = append.payload.len() as u32;
            let at = RecordPosition { segment: segment.first, offset: offset as u32, length };
            written.push(Written { number, at });
        }
        if let Err(error) = segment.medium.append(&bytes) {
            // A full disk refuses here. Nothing of the group may stay: it would be read as written.
            let whole = segment.medium.cut(segment.length).is_ok();
            return Err((WriteFailure::Refused(error), whole));
        }
        if fault() != Some(Fault::AckBeforeSync) {
            // After a failed sync the kernel may have dropped the pages: no second sync of this file can be believed.
            segment.medium.sync().map_err(|error| (WriteFailure::Refused(error), false))?;
        }
        (self.disk.still_ours)().map_err(|error| match error {
            Error::Stopped(reason) => (WriteFailure::Fenced(reason), false),
            other => (WriteFailure::Refused(io::Error::other(other.to_string())), false),
        })?;
        segment.length += bytes.len() as u64;
        self.next += group.len() as u64;
        Ok(written)
    }
}

#[cfg(test)]
mod tests;
