use std::os::unix::fs::PermissionsExt;

use super::super::marker::mark;
use super::*;
use crate::store::backend::owner::Fence as _;

fn hash(dir: &Path) -> u64 {
    DataDir::open(dir).unwrap().hash("car-7")
}

/// Catches: two servers on one directory after somebody removed the lock file.
#[test]
fn a_directory_belongs_to_one_server_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    let first = DataDir::open(dir.path()).unwrap();
    assert!(matches!(DataDir::open(dir.path()), Err(Error::InUse(_))));
    fs::remove_file(dir.path().join("lock")).unwrap();
    assert!(matches!(DataDir::open(dir.path()), Err(Error::InUse(_))), "without the file, too");
    assert!(first.fence().check().is_ok(), "who was refused changed nothing");
    drop(first);
    assert!(DataDir::open(dir.path()).is_ok());
}

/// Catches: one journal, on a volume of its own, under two data directories.
#[test]
fn a_journal_belongs_to_one_server_at_a_time() {
    let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let first = DataDir::open(one.path()).unwrap();
    std::os::unix::fs::symlink(first.journal(), other.path().join("journal")).unwrap();
    assert!(matches!(DataDir::open(other.path()), Err(Error::InUse(_))));
}

/// Catches: a server that goes on acknowledging after another took its directory.
#[test]
fn who_lost_the_directory_notices() {
    let dir = tempfile::tempdir().unwrap();
    let first = DataDir::open(dir.path()).unwrap();
    let second = Fence::take(dir.path()).unwrap();
    assert!(matches!(first.fence().check(), Err(Error::Stopped(_))));
    assert!(second.check().is_ok());
    fs::remove_file(dir.path().join("writer")).unwrap();
    assert!(second.check().is_err(), "without the file it cannot be told");
}

#[test]
fn the_key_is_private_lasting_and_its_own() {
    let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    assert_eq!(hash(one.path()), hash(one.path()));
    assert_ne!(hash(one.path()), hash(other.path()));
    for name in ["key", "key-copy"] {
        let mode = fs::metadata(one.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
}

/// Catches: a flipped bit that makes every contributor a new one.
#[test]
fn a_damaged_or_missing_key_is_mended_from_its_copy() {
    let dir = tempfile::tempdir().unwrap();
    let was = hash(dir.path());
    for name in ["key", "key-copy"] {
        let path = dir.path().join(name);
        let good = fs::read(&path).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 8;
            fs::write(&path, &bad).unwrap();
            assert_eq!(hash(dir.path()), was, "byte {at} of {name}");
            assert_eq!(fs::read(&path).unwrap(), good);
        }
        fs::remove_file(&path).unwrap();
        assert_eq!(hash(dir.path()), was);
        let open = DataDir::open(dir.path()).unwrap();
        assert!(open.damage().is_empty());
        fs::write(&path, "short").unwrap();
        assert_eq!(open.damage().len(), 1);
        fs::write(&path, &good).unwrap();
    }
    for name in ["key", "key-copy"] {
        fs::write(dir.path().join(name), "short").unwrap();
    }
    assert!(DataDir::open(dir.path()).is_err(), "a damaged key is not replaced");
}

#[test]
fn a_key_of_before_there_was_a_checksum_is_taken_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("key"), [7; 16]).unwrap();
    let was = hash(dir.path());
    assert_eq!(fs::read(dir.path().join("key")).unwrap().len(), 24);
    assert_eq!(hash(dir.path()), was);
    let mut hasher = siphasher::sip::SipHasher24::new_with_key(&[7; 16]);
    std::hash::Hasher::write(&mut hasher, b"car-7");
    assert_eq!(was, std::hash::Hasher::finish(&hasher));
}

#[test]
fn two_keys_are_one_too_many() {
    let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    assert_ne!(hash(one.path()), hash(other.path()));
    fs::copy(other.path().join("key"), one.path().join("key-copy")).unwrap();
    assert!(matches!(DataDir::open(one.path()), Err(Error::Damaged { .. })));
}

/// Catches: files of others that are deleted, or that stop the start, because of their names.
#[test]
fn only_what_this_store_made_is_removed() {
    let dir = tempfile::tempdir().unwrap();
    let (ours, theirs) = (Uuid::from_u128(1), Uuid::from_u128(2));
    for name in ["tiles", "tiles-old", "tiles-4", "scratch", "scratch-1", "x.new"] {
        fs::create_dir(dir.path().join(name)).unwrap();
        fs::write(dir.path().join(name).join("thesis.tex"), "years of work").unwrap();
    }
    for name in ["notes.new", "key.new", "tiles.tar", "tiles-18446744073709551615", "tiles-9"] {
        fs::write(dir.path().join(name), "years of work").unwrap();
    }
    let before = files::names(dir.path()).unwrap();
    for (name, journal) in [("tiles-20", ours), ("tiles-21", ours), ("scratch-5", ours), ("tiles-22", theirs)]
    {
        fs::create_dir(dir.path().join(name)).unwrap();
        mark(&dir.path().join(name), journal).unwrap();
    }
    fs::write(dir.path().join("base-7.echofix-unfinished"), "half").unwrap();
    let open = DataDir::open(dir.path());
    assert!(matches!(open, Err(Error::Damaged { .. })), "tiles without a journal");
    fs::create_dir(dir.path().join("journal")).unwrap();
    fs::write(dir.path().join("journal/00000000000000000001.seg"), "").unwrap();
    let open = DataDir::open(dir.path()).unwrap();
    assert_eq!(open.next_generation().unwrap(), 23);
    open.clean(ours, Some(21), true).unwrap();
    let after = files::names(dir.path()).unwrap();
    assert!(before.iter().all(|name| after.contains(name)), "{after:?}");
    let is_there = |name: &str| dir.path().join(name).exists();
    assert!(!is_there("tiles-20") && is_there("tiles-21") && !is_there("scratch-5"));
    assert!(is_there("set-aside/tiles-22") && !is_there("base-7.echofix-unfinished"));
    assert!(before.iter().filter(|name| dir.path().join(name).is_dir()).all(|name| {
        fs::read_to_string(dir.path().join(name).join("thesis.tex")).unwrap() == "years of work"
    }));
    open.clean(ours, None, false).unwrap();
    assert!(is_there("set-aside/tiles-21"), "without a manifest nothing says that it is replaced");
}

/// Catches: an unmounted journal that is taken for a map without uploads, and the rest deleted.
#[test]
fn a_directory_that_lost_its_journal_is_not_begun_anew() {
    let dir = tempfile::tempdir().unwrap();
    for (name, content) in [("manifest", &b"EFM\x04 and so on"[..]), ("base-7", b"EFB\x01 and so on")] {
        fs::write(dir.path().join(name), content).unwrap();
        for journal in [false, true] {
            if journal {
                fs::create_dir(dir.path().join("journal")).unwrap();
            }
            match DataDir::open(dir.path()) {
                Err(Error::Damaged { reason, .. }) => assert!(reason.contains(name), "{reason}"),
                _ => panic!("{name} went unnoticed"),
            }
        }
        fs::remove_dir(dir.path().join("journal")).unwrap();
        fs::remove_file(dir.path().join(name)).unwrap();
    }
    fs::write(dir.path().join("base-7"), "a bass line").unwrap();
    assert!(DataDir::open(dir.path()).is_ok());
}
