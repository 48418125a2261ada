use super::*;
use crate::store::log::entry::RecordSubject;

fn open(dir: &Path, segment_bytes: u64) -> Result<(Journal, Vec<Vec<u8>>), Error> {
    let mut payloads = Vec::new();
    let found = Journal::recover(dir, |_, payload| {
        payloads.push(payload.to_vec());
        Ok(())
    })?;
    Ok((Journal::start(dir, found, (segment_bytes, Fence::at(dir)), |_, _| {}, |_| {})?, payloads))
}

fn append(journal: &Journal, payload: &[u8]) -> Written {
    journal.append(meta(1), false, payload.to_vec()).unwrap()
}

fn meta(day: u16) -> RecordMeta {
    RecordMeta { day, what: RecordSubject::Upload { id: Uuid::nil(), contributor: 1 } }
}

#[test]
fn days_and_fresh_records_begin_segments_and_covered_ones_are_deleted() {
    let dir = tempfile::tempdir().unwrap();
    let (journal, _) = open(dir.path(), 1 << 20).unwrap();
    for day in [7, 7, 8, 8, 8, 7] {
        journal.append(meta(day), false, vec![1]).unwrap();
    }
    journal.append(meta(7), true, vec![1]).unwrap();
    assert_eq!(segments(dir.path()).unwrap(), [1, 3, 6, 7]);
    journal.delete_up_to(4).unwrap();
    assert_eq!(segments(dir.path()).unwrap(), [3, 6, 7], "a segment goes when all of it is covered");
    journal.delete_up_to(100).unwrap();
    assert_eq!(segments(dir.path()).unwrap(), [7], "the newest stays");
    drop(journal);
    let (journal, found) = open(dir.path(), 1 << 20).unwrap();
    assert_eq!((found.len(), append(&journal, b"next").number), (1, 8), "numbers go on");
}

#[test]
fn what_was_appended_is_found_again_over_many_segments() {
    let dir = tempfile::tempdir().unwrap();
    let expected: Vec<Vec<u8>> = (0..50_u8).map(|i| vec![i; usize::from(i)]).collect();
    for chunk in expected.chunks(20) {
        let (journal, _) = open(dir.path(), 200).unwrap();
        for payload in chunk {
            let written = append(&journal, payload);
            assert_eq!(journal.reader().payload(written.at).unwrap(), *payload);
        }
    }
    assert!(segments(dir.path()).unwrap().len() > 5);
    let (journal, found) = open(dir.path(), 200).unwrap();
    assert_eq!(found, expected);
    assert_eq!(append(&journal, b"next").number, 51);
}

#[test]
fn a_missing_or_damaged_older_segment_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let (journal, _) = open(dir.path(), 100).unwrap();
    (0..20).for_each(|_| _ = append(&journal, &[7; 50]));
    drop(journal);
    let second = segment::path(dir.path(), segments(dir.path()).unwrap()[1]);
    let good = fs::read(&second).unwrap();
    let fails = || match open(dir.path(), 100) {
        Err(Error::Damaged { what, .. }) => what,
        _ => panic!("the damage went unnoticed"),
    };
    for at in 0..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 16;
        fs::write(&second, &bad).unwrap();
        assert!(fails().contains(second.to_str().unwrap()), "byte {at}");
    }
    fs::remove_file(&second).unwrap();
    assert!(fails().contains("seg"));
    fs::write(&second, &good).unwrap();
    assert_eq!(open(dir.path(), 100).unwrap().1.len(), 20);
}

#[test]
fn every_truncation_of_the_newest_segment_opens_and_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let (journal, _) = open(dir.path(), 160).unwrap();
    (0..8_u8).for_each(|i| _ = append(&journal, &[i; 40]));
    drop(journal);
    let firsts = segments(dir.path()).unwrap();
    let newest = segment::path(dir.path(), *firsts.last().unwrap());
    let good = fs::read(&newest).unwrap();
    for length in 0..good.len() {
        fs::write(&newest, &good[..length]).unwrap();
        let (journal, found) = open(dir.path(), 160).unwrap();
        assert!(found.len() < 8 && found.iter().zip(0..).all(|(payload, i)| *payload == [i; 40]));
        assert_eq!(append(&journal, b"again").number, found.len() as u64 + 1);
        drop(journal);
        assert_eq!(open(dir.path(), 160).unwrap().1.len(), found.len() + 1);
        for path in segments(dir.path()).unwrap().split_off(firsts.len() - 1) {
            fs::remove_file(segment::path(dir.path(), path)).unwrap();
        }
    }
}

#[test]
fn stray_files_are_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    append(&open(dir.path(), 100).unwrap().0, b"one");
    fs::write(dir.path().join("notes.txt"), "hello").unwrap();
    fs::write(dir.path().join("1.seg"), "hello").unwrap();
    assert_eq!(open(dir.path(), 100).unwrap().1.len(), 1);
    assert!(dir.path().join("notes.txt").exists());
}
