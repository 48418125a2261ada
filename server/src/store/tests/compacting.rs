//! Compacting: the journal's head becomes the checkpoint.

use super::controls::{by_cars, bytes, copy, never_had};
use super::*;

/// Commits uploads as if it were a day.
fn commit_on(store: &EmbeddedStore, day: u16, uploads: &[UploadRecord]) {
    TODAY.set(Some(day));
    commit_all(store, uploads);
}

/// Contributors that no other bytes look like, each passing on one day only.
fn distinct(mut uploads: Vec<UploadRecord>) -> Vec<UploadRecord> {
    for (i, upload) in (0_u64..).zip(&mut uploads) {
        upload.pass.contributor = 0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(i + 1);
    }
    uploads
}

/// Does any file below a directory hold these bytes?
fn holds(dir: &Path, bytes: &[u8]) -> bool {
    std::fs::read_dir(dir).unwrap().any(|entry| {
        let path = entry.unwrap().path();
        if path.is_dir() {
            return holds(&path, bytes);
        }
        std::fs::read(&path).unwrap().windows(bytes.len()).any(|window| window == bytes)
    })
}

fn segments(dir: &Path) -> usize {
    std::fs::read_dir(dir.join("journal")).unwrap().count()
}

#[test]
fn compacted_records_are_gone_and_the_map_is_as_before() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = distinct(some_uploads(40));
    commit_on(&store, 100, &uploads[..15]);
    commit_on(&store, 101, &uploads[15..25]);
    commit_on(&store, 102, &uploads[25..]);
    let before = map(&store);
    let hashes = |range: std::ops::Range<usize>| {
        uploads[range].iter().filter(|u| holds(dir.path(), &u.pass.contributor.to_le_bytes())).count()
    };
    assert_eq!(hashes(0..40), 40, "without compacting they are there, or the test finds nothing");

    assert_eq!(store.compact(100).unwrap(), None, "nothing is that old");
    assert_eq!(store.compact(102).unwrap(), Some(41));
    assert_eq!(map(&store), before, "the same tiles in the same versions");
    assert_eq!(store.compact(102).unwrap(), None, "once is enough");
    // The old tiles go when the last reader lets go of them.
    drop(store);
    assert_eq!((hashes(0..25), hashes(25..40)), (0, 15));

    let store = open(dir.path());
    assert_eq!(map(&store), before);
    assert_eq!(store.totals().uploads, 40);
    assert!(
        store.counted(uploads[0].id).unwrap().is_none() && store.counted(uploads[30].id).unwrap().is_some()
    );
    drop(store);
    std::fs::remove_dir_all(tiles_dir(dir.path())).unwrap();
    let store = open(dir.path());
    assert_eq!(bytes(&store), never_had(&uploads), "checkpoint and journal make the map again");
}

#[test]
fn compacted_uploads_cannot_be_taken_back_and_the_others_can() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let mut uploads = by_cars(&store, some_uploads(30));
    // A contributor that comes again after a compaction is not recognised, and counts as one more contributor.
    uploads[10..].iter_mut().for_each(|upload| upload.pass.contributor ^= 1 << 63);
    commit_on(&store, 100, &uploads[..10]);
    let revoked = store.revoke_upload(uploads[2].id).unwrap();
    commit_on(&store, 102, &uploads[10..]);
    let compacted = store.compact(101).unwrap().unwrap();
    for step in 0..2 {
        let refused = [store.revoke_upload(uploads[0].id), store.rollback(revoked - 1)];
        assert!(refused.iter().all(|r| matches!(r, Err(Error::Unknown(_)))), "{refused:?} at {step}");
        caught_up(&store);
    }
    store.revoke_upload(uploads[20].id).unwrap();
    let left = |gone: &[usize]| {
        let left = (0..30).filter(|i| !gone.contains(i)).map(|i| uploads[i].clone());
        left.collect::<Vec<_>>()
    };
    assert_eq!(bytes(&store), never_had(&left(&[2, 20])));
    store.rollback(revoked).unwrap();
    assert_eq!(
        bytes(&store),
        never_had(&[&uploads[..2], &uploads[3..10]].concat()),
        "back to the checkpoint"
    );
    assert!(compacted > revoked);
}

#[test]
fn a_stop_at_any_step_of_compacting_leaves_a_map_that_goes_on() {
    let stops = [
        (Call::Create(TableUse::Scratch), Fault::LostAnswer),
        (Call::PutObject, Fault::Error),
        (Call::PutObject, Fault::LostAnswer),
        (Call::Create(TableUse::Served), Fault::LostAnswer),
        (Call::Flush(TableUse::Served), Fault::LostAnswer),
        (Call::Publish, Fault::LostAnswer),
        (Call::DeleteSegments, Fault::Error),
    ];
    for stop in stops {
        let dir = tempfile::tempdir().unwrap();
        let faults = Faults::default();
        let store = open_failing(dir.path(), &faults);
        let uploads = distinct(some_uploads(20));
        commit_on(&store, 100, &uploads[..12]);
        commit_on(&store, 101, &uploads[12..]);
        let whole = bytes(&store);
        faults.name(stop.0, stop.1);
        store.compact(101).unwrap();
        wait_for_fault(&store, &faults, dir.path());
        let elsewhere = tempfile::tempdir().unwrap();
        copy(dir.path(), elsewhere.path());
        drop(store);
        for dir in [dir.path(), elsewhere.path()] {
            let store = open(dir);
            // Catches: uploads that count twice while a compaction is done again.
            assert_eq!(store.totals().uploads, 20, "{stop:?}");
            assert_eq!(bytes(&store), whole, "{stop:?}");
            drop(store);
            let left = uploads[..12].iter().filter(|u| holds(dir, &u.pass.contributor.to_le_bytes())).count();
            assert_eq!((left, segments(dir)), (0, 2), "{stop:?}");
        }
    }
}

#[test]
fn a_journal_whose_checkpoint_is_gone_is_not_opened() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    commit_on(&store, 100, &some_uploads(5));
    TODAY.set(Some(101));
    store.compact(101).unwrap();
    caught_up(&store);
    drop(store);
    std::fs::remove_file(dir.path().join("base-5")).unwrap();
    match EmbeddedStore::open(&options(dir.path())) {
        Err(Error::Damaged { reason, .. }) => assert!(reason.contains("base-5"), "{reason}"),
        _ => panic!("the missing checkpoint went unnoticed"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]
    // Breaks it: a checkpoint that keeps excluded uploads, or a start that folds compacted records again.
    #[test]
    fn compacting_at_any_time_changes_no_map(
        days in prop::collection::vec((prop::collection::vec(uploads(), 1..5), 0..4_u8), 1..6),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let mut store = open(dir.path());
        let mut left: Vec<UploadRecord> = Vec::new();
        for (day, (uploads, then)) in (200..).zip(days) {
            // No contributor comes on both sides of a compaction: it would count on either.
            let mut uploads = distinct(uploads);
            for upload in &mut uploads {
                upload.pass.day = day;
                upload.pass.contributor += 1_000 * u64::from(day);
            }
            commit_on(&store, day, &uploads);
            left.extend(uploads);
            match then {
                0 => drop(store.compact(day).unwrap()),
                1 => {
                    let last = left.pop().unwrap();
                    store.revoke_upload(last.id).unwrap();
                    store.compact(day + 1).unwrap();
                }
                2 => {
                    drop(store);
                    store = open(dir.path());
                }
                _ => {}
            }
        }
        prop_assert_eq!(bytes(&store), never_had(&left));
        drop(store);
        std::fs::remove_file(dir.path().join("manifest")).unwrap();
        prop_assert_eq!(bytes(&open(dir.path())), never_had(&left));
    }
}
