use super::*;
use crate::store::backend::Backend;
use crate::store::backend::memory::Memory;
use crate::store::log::entry::RecordSubject;

fn open(disk: &Memory, segment_bytes: u64) -> Result<(Journal, Vec<Vec<u8>>), Error> {
    let Backend { segments, fence, .. } = disk.open();
    let mut payloads = Vec::new();
    let found = Journal::recover(&*segments, |_, payload| {
        payloads.push(payload.to_vec());
        Ok(())
    })?;
    Ok((Journal::start(segments, found, (segment_bytes, fence), |_, _| {}, |_| {})?, payloads))
}

/// First numbers of the segments, in order.
fn firsts(disk: &Memory) -> Vec<u64> {
    disk.open().segments.list().unwrap().iter().map(|segment| segment.first).collect()
}

/// Puts a segment of these bytes in place.
fn put(disk: &Memory, first: u64, bytes: &[u8]) {
    let segments = disk.open().segments;
    let mut whole = [0; HEADER];
    let header = bytes.len().min(HEADER);
    whole[..header].copy_from_slice(&bytes[..header]);
    let mut segment = segments.replace(first, &whole).unwrap();
    segment.append(&bytes[header..]).unwrap();
    segment.cut(bytes.len() as u64).unwrap();
}

fn bytes_of(disk: &Memory, first: u64) -> Vec<u8> {
    read(&*disk.open().segments, first).unwrap()
}

fn append(journal: &Journal, payload: &[u8]) -> Written {
    append_on(journal, 1, false, payload)
}

fn append_on(journal: &Journal, day: u16, fresh: bool, payload: &[u8]) -> Written {
    let record = NewRecord { meta: meta(day), fresh, payload: payload.to_vec(), number: None };
    journal.append_all(vec![record]).unwrap()[0]
}

fn meta(day: u16) -> RecordMeta {
    RecordMeta { day, what: RecordSubject::Upload { id: Uuid::nil(), contributor: 1 } }
}

#[test]
fn days_and_fresh_records_begin_segments_and_covered_ones_are_deleted() {
    let disk = Memory::default();
    let (journal, _) = open(&disk, 1 << 20).unwrap();
    for day in [7, 7, 8, 8, 8, 7] {
        append_on(&journal, day, false, &[1]);
    }
    append_on(&journal, 7, true, &[1]);
    assert_eq!(firsts(&disk), [1, 3, 6, 7]);
    journal.delete_up_to(4).unwrap();
    assert_eq!(firsts(&disk), [3, 6, 7], "a segment goes when all of it is covered");
    journal.delete_up_to(100).unwrap();
    assert_eq!(firsts(&disk), [7], "the newest stays");
    drop(journal);
    let (journal, found) = open(&disk, 1 << 20).unwrap();
    assert_eq!((found.len(), append(&journal, b"next").number), (1, 8), "numbers go on");
}

#[test]
fn what_was_appended_is_found_again_over_many_segments() {
    let disk = Memory::default();
    let expected: Vec<Vec<u8>> = (0..50_u8).map(|i| vec![i; usize::from(i)]).collect();
    for chunk in expected.chunks(20) {
        let (journal, _) = open(&disk, 200).unwrap();
        for payload in chunk {
            let written = append(&journal, payload);
            assert_eq!(journal.reader().payload(written.at).unwrap(), *payload);
        }
    }
    assert!(firsts(&disk).len() > 5);
    let (journal, found) = open(&disk, 200).unwrap();
    assert_eq!(found, expected);
    assert_eq!(append(&journal, b"next").number, 51);
}

#[test]
fn a_missing_or_damaged_older_segment_is_named() {
    let disk = Memory::default();
    let (journal, _) = open(&disk, 100).unwrap();
    (0..20).for_each(|_| _ = append(&journal, &[7; 50]));
    drop(journal);
    let second = firsts(&disk)[1];
    let good = bytes_of(&disk, second);
    let fails = || match open(&disk, 100) {
        Err(Error::Damaged { what, .. }) => what,
        _ => panic!("the damage went unnoticed"),
    };
    for at in 0..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 16;
        put(&disk, second, &bad);
        assert!(fails().contains(&segments::name(second)), "byte {at}");
    }
    disk.open().segments.delete(&[second]).unwrap();
    assert!(fails().contains("seg"));
    put(&disk, second, &good);
    assert_eq!(open(&disk, 100).unwrap().1.len(), 20);
}

#[test]
fn every_truncation_of_the_newest_segment_opens_and_goes_on() {
    let disk = Memory::default();
    let (journal, _) = open(&disk, 160).unwrap();
    (0..8_u8).for_each(|i| _ = append(&journal, &[i; 40]));
    drop(journal);
    let before = firsts(&disk);
    let newest = *before.last().unwrap();
    let good = bytes_of(&disk, newest);
    for length in 0..good.len() {
        put(&disk, newest, &good[..length]);
        let (journal, found) = open(&disk, 160).unwrap();
        assert!(found.len() < 8 && found.iter().zip(0..).all(|(payload, i)| *payload == [i; 40]));
        assert_eq!(append(&journal, b"again").number, found.len() as u64 + 1);
        drop(journal);
        assert_eq!(open(&disk, 160).unwrap().1.len(), found.len() + 1);
        disk.open().segments.delete(&firsts(&disk).split_off(before.len() - 1)).unwrap();
    }
}
