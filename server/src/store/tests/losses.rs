//! A journal, a key or a directory that is lost, or belongs to another.

use super::*;

#[test]
fn acknowledged_uploads_missing_from_the_journal_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = some_uploads(3);
    commit_all(&store, &uploads);
    caught_up(&store);
    drop(store);
    let segment = dir.path().join("journal/00000000000000000001.seg");
    let bytes = std::fs::read(&segment).unwrap();
    std::fs::write(&segment, &bytes[..bytes.len() - 1]).unwrap();
    match EmbeddedStore::open(&options(dir.path())) {
        Err(Error::Damaged { reason, .. }) => assert!(reason.contains("acknowledged"), "{reason}"),
        _ => panic!("the loss went unnoticed"),
    }
    std::fs::remove_file(dir.path().join("manifest")).unwrap();
    assert_eq!(map(&open(dir.path())), model(&uploads[..2]), "the operator may decide to go on");
}

#[test]
fn a_journal_without_its_key_is_not_opened() {
    let dir = tempfile::tempdir().unwrap();
    let key = dir.path().join("key");
    drop(open(dir.path()));
    std::fs::remove_file(&key).unwrap();
    commit_all(&open(dir.path()), &some_uploads(1));
    let bytes = std::fs::read(&key).unwrap();
    std::fs::remove_file(&key).unwrap();
    drop(open(dir.path()));
    assert_eq!(std::fs::read(&key).unwrap(), bytes, "mended from its copy");
    std::fs::remove_file(&key).unwrap();
    std::fs::remove_file(dir.path().join("key-copy")).unwrap();
    match EmbeddedStore::open(&options(dir.path())) {
        Err(Error::Damaged { reason, .. }) => assert!(reason.contains("Restore it"), "{reason}"),
        _ => panic!("the missing key went unnoticed"),
    }
    assert!(!key.exists(), "no new key is made in its place");
    std::fs::write(&key, bytes).unwrap();
    assert_eq!(map(&open(dir.path())), model(&some_uploads(1)));
}

/// Catches: a journal that accepts nothing until a restart, although what failed is mended.
#[test]
fn a_journal_that_cannot_be_reached_refuses_and_goes_on_when_it_is_there_again() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let (journal, gone) = (dir.path().join("journal"), dir.path().join("gone"));
    let uploads = some_uploads(200);
    store.commit(uploads[0].clone()).unwrap();
    caught_up(&store);
    std::fs::rename(&journal, &gone).unwrap();
    // The open segment takes some; the next cannot be made.
    let count = |upload: &&UploadRecord| store.commit((*upload).clone()).is_ok();
    let taken = uploads[1..].iter().take_while(count).count();
    assert!(matches!(store.commit(uploads[taken + 1].clone()), Err(Error::Io { .. })));
    wait_for(&store, |progress| progress.state == MapStatus::Stalled);
    assert!(!map_of_now(&store).is_empty(), "what was folded is served");
    std::fs::rename(&gone, &journal).unwrap();
    commit_all(&store, &uploads[taken + 1..]);
    assert_eq!(map(&store), model(&uploads));
    drop(store);
    assert_eq!(map(&open(dir.path())), model(&uploads));
}

/// Catches: two services that acknowledge the same epoch, and a journal that does not open after it.
#[test]
fn a_service_that_lost_its_directory_stops_acknowledging() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = some_uploads(20);
    commit_all(&store, &uploads[..10]);
    caught_up(&store);
    // As another service does that no lock keeps out, before it reads the journal.
    std::fs::remove_file(dir.path().join("writer")).unwrap();
    assert!(matches!(store.commit(uploads[10].clone()), Err(Error::Stopped(_))));
    assert!(store.progress().borrow().stopped);
    drop(store);
    let store = open(dir.path());
    commit_all(&store, &uploads[11..]);
    let taken = store.totals().uploads;
    assert!((19..=20).contains(&taken), "{taken}");
}
