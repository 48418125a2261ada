//! The thread that writes: one sync for all appends that wait.

use std::io;
use std::sync::mpsc::{Receiver, SyncSender};

use tracing::Span;

use super::medium::LogSegment;
use super::segment::{self, RECORD_HEADER};
use super::{RecordPosition, Written};
use crate::store::Error;
use crate::store::entry::RecordMeta;
use crate::store::faults::{Fault, fault};

/// Bytes written with one sync at most, but for a single larger record.
const GROUP_BYTES: usize = 8 << 20;

/// A record that waits to be written.
pub(super) struct Append {
    pub(super) meta: RecordMeta,
    /// Begins a segment of its own.
    pub(super) fresh: bool,
    pub(super) payload: Vec<u8>,
    /// The span of the caller, for what is logged about its record.
    pub(super) span: Span,
    /// Where the caller waits for the outcome.
    pub(super) done: SyncSender<Result<Written, Error>>,
}

/// Gets every record once it is on disk.
type Deliver = Box<dyn FnMut(RecordMeta, Written) + Send>;

pub(super) struct JournalWriter {
    segment: LogSegment,
    /// Number of the next record.
    next: u64,
    /// Day the newest record was written on.
    day: Option<u16>,
    segment_bytes: u64,
    deliver: Deliver,
    /// Why nothing is accepted any more.
    stopped: Option<String>,
}

/// Why a group is not on disk.
enum WriteFailure {
    /// The file is as it was: the next group may succeed.
    Refused(io::Error),
    /// It is unknown what the file holds.
    Unknown(String),
}

impl JournalWriter {
    pub(super) fn new(
        segment: LogSegment,
        next: u64,
        day: Option<u16>,
        segment_bytes: u64,
        deliver: Deliver,
    ) -> Self {
        Self { segment, next, day, segment_bytes, deliver, stopped: None }
    }

    /// Writes until every sender is gone.
    pub(super) fn run(mut self, receiver: &Receiver<Append>) {
        let mut held = None;
        while let Some(first) = held.take().or_else(|| receiver.recv().ok()) {
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

    /// Writes a group, syncs it, and only then answers.
    fn commit(&mut self, group: Vec<Append>) {
        if fault() == Some(Fault::AckBeforeWrite) {
            // As one that writes now and then.
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        let written = match &self.stopped {
            Some(reason) => Err(WriteFailure::Unknown(reason.clone())),
            None => self.roll(&group[0]).and_then(|()| self.write(&group)),
        };
        match written {
            Ok(written) => {
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

    fn refuse(&mut self, group: Vec<Append>, failure: &WriteFailure) {
        match failure {
            WriteFailure::Refused(error) => tracing::error!(%error, "the journal could not be written"),
            WriteFailure::Unknown(reason) if self.stopped.is_none() => {
                tracing::error!(reason, "the journal stopped accepting writes");
                self.stopped = Some(reason.clone());
            }
            WriteFailure::Unknown(_) => {}
        }
        for append in group {
            let error = match failure {
                WriteFailure::Refused(error) => {
                    // An `io::Error` cannot be cloned; its kind and message are what matters.
                    let source = io::Error::new(error.kind(), error.to_string());
                    Error::Io { doing: "writing the journal", source }
                }
                WriteFailure::Unknown(reason) => Error::Stopped(reason.clone()),
            };
            append.span.in_scope(|| tracing::warn!("a record was not written"));
            let _ = append.done.send(Err(error));
        }
    }

    /// Starts a new segment when the current one is full or of another day.
    fn roll(&mut self, first: &Append) -> Result<(), WriteFailure> {
        let another_day = self.day.is_some_and(|day| day != first.meta.day);
        let full = self.segment.length >= self.segment_bytes;
        if !full && (self.segment.first == self.next || !(another_day || first.fresh)) {
            return Ok(());
        }
        let LogSegment { dir, journal, .. } = &self.segment;
        match LogSegment::create(dir, *journal, self.next) {
            Ok(segment) => self.segment = segment,
            // Half a segment may be there now: a restart removes it.
            Err(error) => return Err(WriteFailure::Unknown(error.to_string())),
        }
        Ok(())
    }

    fn write(&mut self, group: &[Append]) -> Result<Vec<Written>, WriteFailure> {
        let synced = self.next - 1;
        let mut bytes = Vec::with_capacity(group.iter().map(|a| RECORD_HEADER + a.payload.len()).sum());
        let mut written = Vec::with_capacity(group.len());
        for (number, append) in (self.next..).zip(group) {
            let offset = self.segment.length + (bytes.len() + RECORD_HEADER) as u64;
            segment::put_record(&mut bytes, number, synced, &append.payload);
            let length = append.payload.len() as u32;
            let at = RecordPosition { segment: self.segment.first, offset: offset as u32, length };
            written.push(Written { number, at });
        }
        if let Err(error) = self.segment.medium.append(&bytes) {
            // A full disk refuses here. Nothing of the group may stay: it would be read as written.
            return Err(match self.segment.medium.cut(self.segment.length) {
                Ok(()) => WriteFailure::Refused(error),
                Err(cut) => WriteFailure::Unknown(format!("{error}; {cut}")),
            });
        }
        if fault() != Some(Fault::AckBeforeSync) {
            // After a failed sync the kernel may have dropped the pages: no second sync can be believed.
            self.segment.medium.sync().map_err(|error| WriteFailure::Unknown(error.to_string()))?;
        }
        self.segment.length += bytes.len() as u64;
        self.next += group.len() as u64;
        Ok(written)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::sync::{Arc, Mutex};

    use uuid::Uuid;

    use super::super::medium::Medium;
    use super::*;
    use crate::store::entry::RecordSubject;

    /// A disk that fails on request.
    #[derive(Clone, Default)]
    struct Faulty(Arc<Mutex<Faults>>);

    #[derive(Default)]
    struct Faults {
        bytes: Vec<u8>,
        append_fails: bool,
        sync_fails: bool,
        cut_fails: bool,
    }

    impl Medium for Faulty {
        fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
            let mut disk = self.0.lock().unwrap();
            let taken = if disk.append_fails { bytes.len() / 2 } else { bytes.len() };
            disk.bytes.extend_from_slice(&bytes[..taken]);
            if disk.append_fails { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
        }

        fn sync(&mut self) -> io::Result<()> {
            if self.0.lock().unwrap().sync_fails { Err(io::Error::other("I/O error")) } else { Ok(()) }
        }

        fn cut(&mut self, length: u64) -> io::Result<()> {
            let mut disk = self.0.lock().unwrap();
            if disk.cut_fails {
                return Err(io::Error::other("cut failed"));
            }
            disk.bytes.truncate(length as usize);
            Ok(())
        }
    }

    fn writer(disk: &Faulty) -> JournalWriter {
        let medium = Box::new(disk.clone());
        let segment = LogSegment { dir: "nowhere".into(), journal: Uuid::nil(), first: 1, length: 0, medium };
        JournalWriter::new(segment, 1, None, u64::MAX, Box::new(|_, _| {}))
    }

    fn append(writer: &mut JournalWriter) -> Result<Written, Error> {
        let (done, outcome) = mpsc::sync_channel(1);
        let meta = RecordMeta { day: 1, what: RecordSubject::Upload { id: Uuid::nil(), contributor: 1 } };
        writer.commit(vec![Append {
            meta,
            fresh: false,
            payload: b"payload".to_vec(),
            span: Span::none(),
            done,
        }]);
        outcome.recv().unwrap()
    }

    #[test]
    fn a_full_disk_refuses_and_recovers_once_freed() {
        let disk = Faulty::default();
        let mut writer = writer(&disk);
        assert_eq!(append(&mut writer).unwrap().number, 1);
        disk.0.lock().unwrap().append_fails = true;
        assert!(matches!(append(&mut writer), Err(Error::Io { .. })));
        disk.0.lock().unwrap().append_fails = false;
        assert_eq!(append(&mut writer).unwrap().number, 2);
        let bytes = disk.0.lock().unwrap().bytes.clone();
        let second = segment::parse_record(&bytes[RECORD_HEADER + 7..]).unwrap();
        assert_eq!((second.number, second.synced), (2, 1), "nothing of the refused record is left");
    }

    #[test]
    fn after_a_failed_sync_or_cut_nothing_is_accepted_again() {
        for (sync_fails, append_fails) in [(true, false), (false, true)] {
            let disk = Faulty::default();
            let mut writer = writer(&disk);
            *disk.0.lock().unwrap() = Faults { sync_fails, append_fails, cut_fails: true, bytes: vec![] };
            assert!(matches!(append(&mut writer), Err(Error::Stopped(_))));
            *disk.0.lock().unwrap() = Faults::default();
            assert!(matches!(append(&mut writer), Err(Error::Stopped(_))));
        }
    }
}
