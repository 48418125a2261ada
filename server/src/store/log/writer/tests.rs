use std::collections::BTreeMap;
use std::sync::mpsc;
use std::sync::{Arc, Mutex};

use uuid::Uuid;

use super::*;
use crate::store::backend::segments::Medium;
use crate::store::log::entry::RecordSubject;
use crate::store::log::recover;

/// A disk that fails on request.
#[derive(Clone, Default)]
struct Faulty(Arc<Mutex<Faults>>);

#[expect(clippy::struct_excessive_bools, reason = "each stands for a call that fails by itself")]
#[derive(Default)]
struct Faults {
    /// The segments, by their first record.
    segments: BTreeMap<u64, Vec<u8>>,
    append_fails: bool,
    sync_fails: bool,
    cut_fails: bool,
    create_fails: bool,
    taken_over: bool,
    /// What was told of it.
    refusing: Vec<bool>,
}

/// A segment of it.
struct FaultySegment(Faulty, u64);

impl Medium for FaultySegment {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut disk = self.0.0.lock().unwrap();
        let taken = if disk.append_fails { bytes.len() / 2 } else { bytes.len() };
        disk.segments.get_mut(&self.1).unwrap().extend_from_slice(&bytes[..taken]);
        if disk.append_fails { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    }

    fn sync(&mut self) -> io::Result<()> {
        if self.0.0.lock().unwrap().sync_fails { Err(io::Error::other("I/O error")) } else { Ok(()) }
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        let mut disk = self.0.0.lock().unwrap();
        if disk.cut_fails {
            return Err(io::Error::other("cut failed"));
        }
        disk.segments.get_mut(&self.1).unwrap().truncate(length as usize);
        Ok(())
    }
}

impl Faulty {
    fn set(&self, change: impl FnOnce(&mut Faults)) {
        change(&mut self.0.lock().unwrap());
    }

    fn heal(&self) {
        self.set(|disk| {
            let (segments, refusing) =
                (std::mem::take(&mut disk.segments), std::mem::take(&mut disk.refusing));
            *disk = Faults { segments, refusing, ..Faults::default() };
        });
    }

    /// The records that a start would count.
    fn recovered(&self) -> Vec<(u64, Vec<u8>)> {
        let disk = self.0.lock().unwrap();
        let ends = disk.segments.keys().skip(1).copied().map(Some).chain([None]);
        let mut found = Vec::new();
        for ((first, bytes), end) in disk.segments.iter().zip(ends) {
            let visit = |_: usize, record: &segment::FramedRecord<'_>| {
                found.push((record.number, record.payload.to_vec()));
            };
            recover::walk(bytes, *first, end, visit).unwrap();
        }
        found
    }

    fn writer(&self) -> JournalWriter {
        let disk = self.clone();
        let create = move |first| {
            if disk.0.lock().unwrap().create_fails {
                return Err(Error::Io { doing: "creating", source: io::ErrorKind::StorageFull.into() });
            }
            let header = segment::header(Uuid::nil(), first).to_vec();
            let length = header.len() as u64;
            let taken = disk.0.lock().unwrap().segments.insert(first, header);
            assert_eq!(taken, None, "a segment is begun once");
            Ok(LogSegment { first, length, medium: Box::new(FaultySegment(disk.clone(), first)) })
        };
        let disk = self.clone();
        let still_ours = move || {
            let lost = disk.0.lock().unwrap().taken_over;
            if lost { Err(Error::Stopped("another server".to_owned())) } else { Ok(()) }
        };
        let disk = Disk { create: Box::new(create), still_ours: Box::new(still_ours) };
        let refusing = self.clone();
        let refusing = move |now| refusing.set(|disk| disk.refusing.push(now));
        JournalWriter::new(disk, (1, None), u64::MAX, (Box::new(|_, _| {}), Box::new(refusing)))
    }
}

fn append(writer: &mut JournalWriter, payload: &[u8]) -> Result<Written, Error> {
    append_as(writer, None, payload)
}

fn append_as(writer: &mut JournalWriter, number: Option<u64>, payload: &[u8]) -> Result<Written, Error> {
    let (done, outcome) = mpsc::sync_channel(1);
    let meta = RecordMeta { day: 1, what: RecordSubject::Upload { id: Uuid::nil(), contributor: 1 } };
    let payload = payload.to_vec();
    writer.commit(vec![Append { meta, fresh: false, payload, number, span: Span::none(), done }]);
    outcome.recv().unwrap()
}

/// Catches: a service that takes no uploads until a restart, or one that loses or invents some, after its disk
/// failed in any of its ways and went on.
#[test]
fn whatever_fails_what_was_acknowledged_is_there_and_writing_goes_on() {
    let ways: [fn(&mut Faults); 5] = [
        |disk| disk.append_fails = true,
        |disk| (disk.append_fails, disk.cut_fails) = (true, true),
        |disk| disk.sync_fails = true,
        |disk| (disk.sync_fails, disk.create_fails) = (true, true),
        |disk| disk.create_fails = true,
    ];
    for (way, fails) in ways.into_iter().enumerate() {
        for before in 0..3_u8 {
            let disk = Faulty::default();
            let mut writer = disk.writer();
            let mut counted = Vec::new();
            let count = |writer: &mut JournalWriter, payload: u8| {
                (append(writer, &[payload]).unwrap().number, vec![payload])
            };
            counted.extend((0..before).map(|payload| count(&mut writer, payload)));
            disk.set(fails);
            let refused = [append(&mut writer, b"refused"), append(&mut writer, b"refused")];
            let all = refused.iter().all(|outcome| matches!(outcome, Err(Error::Io { .. })));
            assert!(all || (way == 4 && before > 0), "way {way} after {before}: {refused:?}");
            disk.heal();
            if !all {
                continue;
            }
            assert!(writer.probe().is_ok());
            assert_eq!(disk.recovered(), counted, "way {way} after {before}, probed");
            counted.extend((10..13).map(|payload| count(&mut writer, payload)));
            assert_eq!(disk.recovered(), counted, "way {way} after {before}");
            assert_eq!(disk.0.lock().unwrap().refusing, [true, false]);
        }
    }
}

/// Catches: two services that both acknowledge a record of one number.
#[test]
fn who_lost_the_directory_acknowledges_nothing() {
    let disk = Faulty::default();
    let mut writer = disk.writer();
    append(&mut writer, b"one").unwrap();
    disk.set(|disk| disk.taken_over = true);
    assert!(matches!(append(&mut writer, b"two"), Err(Error::Stopped(_))));
    // The other one read one record, and goes on in a segment of its own.
    let mut second = vec![0; 0];
    second.extend_from_slice(&segment::header(Uuid::nil(), 2));
    segment::put_record(&mut second, 2, 1, b"theirs");
    disk.heal();
    disk.set(|disk| _ = disk.segments.insert(2, second));
    assert!(matches!(append(&mut writer, b"three"), Err(Error::Stopped(_))), "for good");
    assert_eq!(disk.recovered(), [(1, b"one".to_vec()), (2, b"theirs".to_vec())]);
}

/// Catches: a copy of a shared journal in which, after its disk refused a record and took the next one, all have numbers of
/// others.
#[test]
fn a_record_that_has_a_number_elsewhere_gets_no_other_one() {
    let disk = Faulty::default();
    let mut writer = disk.writer();
    assert_eq!(append_as(&mut writer, Some(1), b"one").unwrap().number, 1);
    disk.set(|disk| disk.append_fails = true);
    append_as(&mut writer, Some(2), b"two").unwrap_err();
    disk.set(|disk| disk.append_fails = false);
    append_as(&mut writer, Some(3), b"three").unwrap_err();
    for (number, payload) in [(2, b"two".as_slice()), (3, b"three")] {
        assert_eq!(append_as(&mut writer, Some(number), payload).unwrap().number, number);
    }
}
