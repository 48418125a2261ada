//! The journal: append-only, checksummed segment files. What [`Journal::append_all`] returns for is on
//! disk.

use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;

use tracing::Span;
use uuid::Uuid;

use super::entry::RecordMeta;
use super::faults::{Fault, fault};
use super::medium::LogSegment;
use super::position::{RecordPosition, Written};
use super::reader::{RecordReader, damaged};
use super::sequencer::{NewRecord, Sequenced, Sequencer};
use super::writer::{Append, JournalWriter};
use super::{medium, recover, segment, writer};
use crate::store::api::{Error, io_error};
use crate::store::backend::objects::Readable;
use crate::store::backend::owner::Fence;
use crate::store::backend::segments::{self, HEADER, Listed, Segments};

/// What is to be copied: its name in the archive, and how many bytes of it.
pub(in crate::store) struct BackupPart {
    pub(in crate::store) name: String,
    pub(in crate::store) object: Box<dyn Readable>,
    pub(in crate::store) length: u64,
}

/// The open journal. Dropping it finishes what was being written.
pub(in crate::store) struct Journal {
    segments: Arc<dyn Segments>,
    sender: Option<Mutex<Sender<Append>>>,
    writer: Option<JoinHandle<()>>,
    sequencer: OnceLock<Box<dyn Sequencer>>,
}

/// The journal as it was found on disk.
pub(in crate::store) struct RecoveredJournal {
    id: Uuid,
    next: u64,
    /// The newest segment, if it holds no record.
    empty: Option<LogSegment>,
}

impl RecoveredJournal {
    /// The journal's own name, by which tiles that were folded from it are recognised.
    pub(in crate::store) fn id(&self) -> Uuid {
        self.id
    }

    /// Number of the last record; of the one before the first where there is none.
    pub(in crate::store) fn end(&self) -> u64 {
        self.next - 1
    }
}

impl Journal {
    /// Reads and checks every record, oldest first, and cuts a torn write off the newest segment.
    ///
    /// # Errors
    /// When the disk refuses, or a record that had been on disk is damaged or missing.
    pub(in crate::store) fn recover(
        segments: &dyn Segments,
        mut visit: impl FnMut(Written, &[u8]) -> Result<(), Error>,
    ) -> Result<RecoveredJournal, Error> {
        let mut listed = list(segments)?;
        drop_unfinished(segments, &mut listed)?;
        let firsts: Vec<u64> = listed.iter().map(|segment| segment.first).collect();
        let Some(&newest) = firsts.last() else {
            let id = Uuid::now_v7();
            let empty = Some(LogSegment::create(segments, id, 1, || Ok(()))?);
            return Ok(RecoveredJournal { id, next: 1, empty });
        };
        // Older ones were compacted: whether something covers them, the store knows.
        let (mut id, mut next, mut length) = (None, firsts[0], 0);
        let ends = firsts.iter().skip(1).copied().map(Some).chain([None]);
        for (first, end) in firsts.iter().copied().zip(ends) {
            let bytes = read(segments, first)?;
            let damaged = |at, reason| damaged(segments, first, at, reason);
            let header = segment::parse_header(&bytes).filter(|(_, named)| *named == first);
            let (journal, _) = header.ok_or_else(|| damaged(0, "its header is not sound"))?;
            if first != next || id.is_some_and(|id| id != journal) {
                return Err(damaged(0, "it does not continue the segment before it"));
            }
            id = Some(journal);
            let mut result = Ok(());
            let sound = recover::walk(&bytes, first, end, |offset, record| {
                let offset = (offset + segment::RECORD_HEADER) as u32;
                let at = RecordPosition { segment: first, offset, length: record.payload.len() as u32 };
                if result.is_ok() {
                    result = visit(Written { number: record.number, at }, record.payload);
                }
            })
            .map_err(|damage| damaged(damage.at, damage.reason))?;
            result?;
            if sound.length < bytes.len() {
                let left = bytes.len() - sound.length;
                tracing::warn!(
                    segment = segments.locate(first),
                    left,
                    "left out a write that was never acknowledged"
                );
            }
            (next, length) = (sound.next, sound.length);
        }
        let id = id.unwrap_or_default();
        medium::settle(segments, newest, length as u64)?;
        // On a full disk it stays as it is; the next record is refused then, and begins another.
        let empty = (newest == next).then(|| LogSegment::replace(segments, id, newest).ok()).flatten();
        Ok(RecoveredJournal { id, next, empty })
    }

    /// Starts writing, into a segment of its own: the ones that were found stay as they are. `deliver` gets every
    /// record in order, once it is on disk and before its append returns; `refusing` is told when the disk begins to refuse
    /// writes, and when it takes them again.
    pub(in crate::store) fn start(
        segments: Arc<dyn Segments>,
        found: RecoveredJournal,
        (segment_bytes, fence): (u64, Arc<dyn Fence>),
        deliver: impl FnMut(RecordMeta, Written) + Send + 'static,
        refusing: impl FnMut(bool) + Send + 'static,
    ) -> Result<Self, Error> {
        let (sender, receiver) = mpsc::channel();
        let (of_writer, id) = (segments.clone(), found.id);
        let of_segments = fence.clone();
        let create = move |first| LogSegment::create(&*of_writer, id, first, || of_segments.check());
        let disk = writer::Disk { create: Box::new(create), still_ours: Box::new(move || fence.check()) };
        let found = (found.next, found.empty);
        let writer = JournalWriter::new(disk, found, segment_bytes, (Box::new(deliver), Box::new(refusing)));
        let thread = std::thread::Builder::new().name("journal".to_owned());
        let writer = thread.spawn(move || writer.run(&receiver)).map_err(io_error("starting the journal"))?;
        let (sender, writer) = (Some(Mutex::new(sender)), Some(writer));
        Ok(Self { segments, sender, writer, sequencer: OnceLock::new() })
    }

    /// From now on a sequencer gives [submitted](Self::submit) records their numbers.
    pub(in crate::store) fn follow(&self, sequencer: Box<dyn Sequencer>) {
        // There is one for as long as the journal is open.
        let _ = self.sequencer.set(sequencer);
    }

    /// Writes records in the order that counts: this journal's own, or its sequencer's.
    ///
    /// # Errors
    /// When it is not certain that all of them are in it.
    pub(in crate::store) fn submit(&self, records: Vec<NewRecord>) -> Result<Vec<Sequenced>, Error> {
        if let Some(sequencer) = self.sequencer.get() {
            return sequencer.sequence(records);
        }
        let written = self.append_all(records)?;
        Ok(written.into_iter().map(|written| Sequenced { written, known: false }).collect())
    }

    /// Writes records in order, with as few syncs as they need, and returns once all are on disk.
    ///
    /// # Errors
    /// When that is not certain for any of them.
    pub(in crate::store) fn append_all(&self, records: Vec<NewRecord>) -> Result<Vec<Written>, Error> {
        let sent = records.into_iter().map(|record| self.send(record));
        let outcomes = sent.collect::<Result<Vec<_>, _>>()?;
        if fault() == Some(Fault::AckBeforeWrite) {
            let nowhere = RecordPosition { segment: 0, offset: 0, length: 0 };
            return Ok(outcomes.iter().map(|_| Written { number: 0, at: nowhere }).collect());
        }
        outcomes.into_iter().map(|outcome| outcome.recv().map_err(|_| gone())?).collect()
    }

    fn send(&self, record: NewRecord) -> Result<Receiver<Result<Written, Error>>, Error> {
        let NewRecord { meta, fresh, payload, number } = record;
        let (done, outcome) = mpsc::sync_channel(1);
        let sender = self.sender.as_ref().ok_or_else(gone)?;
        let sender = sender.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let span = Span::current();
        sender.send(Append { meta, fresh, payload, number, span, done }).map_err(|_| gone())?;
        Ok(outcome)
    }

    /// Deletes the segments all of whose records have numbers up to `last`, oldest first, but never
    /// the newest.
    ///
    /// # Errors
    /// When the disk refuses.
    pub(in crate::store) fn delete_up_to(&self, last: u64) -> Result<(), Error> {
        let listed = list(&*self.segments)?;
        let covered = listed.iter().zip(listed.iter().skip(1)).filter(|(_, next)| next.first <= last + 1);
        let covered: Vec<u64> = covered.map(|(segment, _)| segment.first).collect();
        self.segments.delete(&covered).map_err(io_error("deleting compacted segments"))
    }

    /// The journal's files up to a record that is on disk; all of them, as they are, without one.
    ///
    /// # Errors
    /// When the disk refuses.
    pub(in crate::store) fn parts(&self, last: Option<RecordPosition>) -> Result<Vec<BackupPart>, Error> {
        let opening = "opening a journal segment";
        let mut parts = Vec::new();
        for Listed { first, .. } in list(&*self.segments)? {
            let object = self.segments.open(first).map_err(io_error(opening))?;
            let whole = object.length().map_err(io_error(opening))?;
            let length = match last {
                Some(last) if first > last.segment => continue,
                Some(last) if first == last.segment => u64::from(last.offset) + u64::from(last.length),
                _ => whole,
            };
            parts.push(BackupPart { name: format!("journal/{}", segments::name(first)), object, length });
        }
        Ok(parts)
    }

    /// Payloads of records, read with as few opened files as their order allows.
    pub(in crate::store) fn reader(&self) -> RecordReader<'_> {
        RecordReader::of(&*self.segments)
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        self.sender = None;
        if let Some(writer) = self.writer.take() {
            // It logged its own end.
            let _ = writer.join();
        }
    }
}

fn list(segments: &dyn Segments) -> Result<Vec<Listed>, Error> {
    segments.list().map_err(io_error("listing the journal"))
}

/// A whole segment.
fn read(segments: &dyn Segments, first: u64) -> Result<Vec<u8>, Error> {
    let read = || {
        let segment = segments.open(first)?;
        let mut bytes = vec![0; segment.length()? as usize];
        segment.read_at(0, &mut bytes)?;
        Ok(bytes)
    };
    read().map_err(io_error("reading a journal segment"))
}

/// Removes the newest segment when the crash came before its header was on disk: it never held a
/// record, because none is written before the header is synced.
fn drop_unfinished(segments: &dyn Segments, listed: &mut Vec<Listed>) -> Result<(), Error> {
    let Some(Listed { first, bytes }) = listed.last().copied() else { return Ok(()) };
    if bytes <= HEADER as u64 && segment::parse_header(&read(segments, first)?).is_none() {
        segments.delete(&[first]).map_err(io_error("removing an unfinished journal segment"))?;
        listed.pop();
    }
    Ok(())
}

fn gone() -> Error {
    Error::Stopped("the journal's thread has ended".to_owned())
}

#[cfg(test)]
mod tests;
