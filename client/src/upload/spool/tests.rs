//! A spool through restarts, damage and want of room.

use super::*;
use crate::testing::upload;
use std::fs;

fn drain(spool: &Spool) -> Vec<Uuid> {
    let mut ids = Vec::new();
    while let Some(id) = spool.oldest(&HashSet::new()) {
        if let Some(upload) = spool.read(id).unwrap() {
            ids.push(upload.id());
            spool.remove(id).unwrap();
        }
    }
    ids
}

#[test]
fn uploads_survive_a_restart_in_order() {
    let dir = tempfile::tempdir().unwrap();
    let uploads: Vec<_> = (0..5).map(|_| upload(3)).collect();
    let spool = Spool::open(dir.path(), SpoolLimits::default()).unwrap();
    for upload in &uploads {
        spool.push(upload).unwrap();
    }
    assert!(matches!(Spool::open(dir.path(), SpoolLimits::default()), Err(Error::InUse { .. })));
    let bytes = spool.bytes();
    drop(spool);
    fs::write(dir.path().join(format!("{}.part", Uuid::now_v7())), "half").unwrap();
    fs::write(dir.path().join("notes.txt"), "someone's").unwrap();
    let spool = Spool::open(dir.path(), SpoolLimits::default()).unwrap();
    assert_eq!((spool.len(), spool.bytes()), (5, bytes));
    assert_eq!(spool.read(uploads[2].id()).unwrap().as_ref(), Some(&uploads[2]));
    assert_eq!(drain(&spool), uploads.iter().map(PreparedUpload::id).collect::<Vec<_>>());
    assert_eq!((spool.len(), spool.bytes()), (0, 0));
    let left: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(!left.iter().any(|n| n.to_string_lossy().ends_with(".part")), "{left:?}");
}

#[test]
fn a_full_spool_refuses_the_newest_and_keeps_the_rest() {
    let dir = tempfile::tempdir().unwrap();
    let (a, b) = (upload(100), upload(100));
    let size = file::seal(&a.encode()).len() as u64;
    let limits = SpoolLimits { max_bytes: size + size / 2, ..SpoolLimits::default() };
    let spool = Spool::open(dir.path(), limits).unwrap();
    spool.push(&a).unwrap();
    let error = spool.push(&b).unwrap_err();
    assert!(matches!(error, Error::Full { .. }), "{error}");
    spool.push(&a).unwrap();
    assert_eq!((spool.len(), spool.bytes()), (1, size), "the same upload again takes no more room");
    assert_eq!(drain(&spool), [a.id()]);
    spool.push(&b).unwrap();
}

#[test]
fn damage_is_set_aside_and_the_queue_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let uploads: Vec<_> = (0..4).map(|_| upload(3)).collect();
    let spool = Spool::open(dir.path(), SpoolLimits::default()).unwrap();
    for upload in &uploads {
        spool.push(upload).unwrap();
    }
    drop(spool);
    let path = |i: usize| dir.path().join(format!("{}.upload", uploads[i].id()));
    let mut bytes = fs::read(path(0)).unwrap();
    bytes[30] ^= 1;
    fs::write(path(0), bytes).unwrap();
    fs::write(path(1), "").unwrap();
    fs::copy(path(3), path(2)).unwrap();
    let spool = Spool::open(dir.path(), SpoolLimits::default()).unwrap();
    assert_eq!(drain(&spool), [uploads[3].id()]);
    for damaged in &uploads[..3] {
        let text = dir.path().join("damaged").join(format!("{}.txt", damaged.id()));
        assert!(!fs::read_to_string(text).unwrap().is_empty());
    }
}

#[test]
fn refused_uploads_are_kept_with_the_reason_within_a_bound() {
    let dir = tempfile::tempdir().unwrap();
    let uploads: Vec<_> = (0..6).map(|_| upload(100)).collect();
    let size = file::seal(&uploads[0].encode()).len() as u64;
    let limits = SpoolLimits { max_set_aside_bytes: 3 * size, ..SpoolLimits::default() };
    let spool = Spool::open(dir.path(), limits).unwrap();
    for upload in &uploads {
        spool.push(upload).unwrap();
        spool.refuse(upload.id(), "TOO_OLD").unwrap();
    }
    assert!(spool.is_empty());
    let refused = dir.path().join("refused");
    let newest = refused.join(format!("{}.txt", uploads[5].id()));
    assert_eq!(fs::read_to_string(newest).unwrap(), "TOO_OLD");
    let sizes = fs::read_dir(&refused).unwrap().map(|e| e.unwrap().metadata().unwrap().len());
    assert!(sizes.sum::<u64>() <= 3 * size);
}

/// Catches: a waiting upload without a file, or two that are counted as one, where one is pushed again while it is sent.
#[test]
fn what_is_pushed_while_it_is_sent_waits_whole_or_not_at_all() {
    let dir = tempfile::tempdir().unwrap();
    let spool = Spool::open(dir.path(), SpoolLimits::default()).unwrap();
    let again = upload(20);
    let size = file::seal(&again.encode()).len() as u64;
    std::thread::scope(|scope| {
        let pushing = scope.spawn(|| (0..200).for_each(|_| spool.push(&again).unwrap()));
        while !pushing.is_finished() {
            if let Some(id) = spool.oldest(&HashSet::new()) {
                assert!(spool.read(id).unwrap().is_some(), "it waits, and is not there");
                spool.remove(id).unwrap();
            }
        }
    });
    assert_eq!(spool.bytes(), size * spool.len() as u64);
}
