//! Export, import, backup, verification.

use super::controls::{by_cars, bytes, never_had};
use super::*;
use crate::store::map::write_buffer::Source;

fn region(store: &EmbeddedStore) -> Region {
    Region { bounds_deg: [-180.0, -90.0, 180.0, 90.0], tiles: map(store).into_keys().collect() }
}

fn exported(store: &EmbeddedStore) -> Vec<u8> {
    let mut file = Vec::new();
    let region = region(store);
    assert_eq!(store.export(&region, &mut file).unwrap(), region.tiles.len() as u64);
    file
}

#[test]
fn a_region_moves_to_another_map_once_and_survives_its_rebuilds() {
    let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let ours = open(here.path());
    commit_all(&ours, &some_uploads(20));
    let file = exported(&ours);
    let theirs = open(there.path());
    let first = theirs.import(&mut &file[..]).unwrap();
    assert_eq!((first.known, first.epoch), (0, first.tiles));
    assert_eq!(bytes(&theirs), bytes(&ours), "where there is no map, the file is the map");
    let again = theirs.import(&mut &file[..]).unwrap();
    assert_eq!((again.known, again.file, again.epoch), (first.tiles, first.file, first.epoch));

    let own = by_cars(&theirs, some_uploads(30).split_off(20));
    commit_all(&theirs, &own);
    let both = map(&theirs);
    drop(theirs);
    std::fs::remove_dir_all(tiles_dir(there.path())).unwrap();
    let theirs = open(there.path());
    assert_eq!(map(&theirs), both);
    theirs.revoke_upload(first.file).unwrap();
    assert_eq!(bytes(&theirs), never_had(&own), "an import is revoked by its file's id");
}

#[test]
fn a_file_that_is_not_whole_and_sound_changes_nothing() {
    let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let ours = open(here.path());
    commit_all(&ours, &some_uploads(2));
    let file = exported(&ours);
    let theirs = open(there.path());
    for at in 0..file.len() {
        let mut bad = file.clone();
        bad[at] ^= 2;
        for bad in [&bad[..], &file[..at]] {
            assert!(matches!(theirs.import(&mut &*bad), Err(Error::Unusable(_))), "byte {at}");
        }
    }
    let longer = [&file[..], &[0]].concat();
    assert!(matches!(theirs.import(&mut &longer[..]), Err(Error::Unusable(_))));
    assert_eq!(theirs.progress().borrow().journaled, 0);
    let left = std::fs::read_dir(there.path()).unwrap();
    assert!(left.into_iter().all(|e| !e.unwrap().file_name().to_string_lossy().starts_with("import")));
}

/// Unpacks as far as a backup needs it: names, lengths, bytes.
fn unpack(mut archive: &[u8], to: &Path) {
    std::fs::create_dir_all(to.join("journal")).unwrap();
    while archive[0] != 0 {
        let (header, rest) = archive.split_at(512);
        let text = |range: std::ops::Range<usize>| {
            std::str::from_utf8(&header[range]).unwrap().trim_end_matches('\0').to_owned()
        };
        let length = usize::from_str_radix(&text(124..136), 8).unwrap();
        std::fs::write(to.join(text(0..100)), &rest[..length]).unwrap();
        archive = &rest[length.next_multiple_of(512)..];
    }
    assert_eq!(archive, [0; 1024]);
}

#[test]
fn a_backup_is_the_store_as_it_was() {
    let (dir, copy) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let store = open(dir.path());
    let uploads = by_cars(&store, some_uploads(30));
    TODAY.set(Some(100));
    commit_all(&store, &uploads[..10]);
    TODAY.set(Some(101));
    commit_all(&store, &uploads[10..20]);
    store.compact(101).unwrap();
    let then = bytes(&store);
    let mut archive = Vec::new();
    // The archive ends where the journal did: what comes after is not in it.
    let written = std::thread::scope(|scope| {
        let later = scope.spawn(|| commit_all(&store, &uploads[20..]));
        later.join().unwrap();
        store.backup(&mut archive).unwrap()
    });
    assert!(written > 0 && (archive.len() as u64) > written);
    unpack(&archive, copy.path());
    let restored = open(copy.path());
    assert_eq!(bytes(&restored), bytes(&store));
    assert_ne!(bytes(&restored), then);
    assert_eq!(restored.contributor("car-1"), store.contributor("car-1"), "the key came along");
    assert!(matches!(restored.commit(uploads[15].clone()).unwrap(), Receipt::Duplicate { .. }));
}

/// Breaks it: a lineage that is drawn at every start, or that comes along with a backup.
#[test]
fn a_restored_backup_is_of_another_lineage_and_a_restart_or_a_rebuild_is_not() {
    let (dir, copy) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let store = open(dir.path());
    commit_all(&store, &some_uploads(3));
    let lineage = store.lineage();
    let mut archive = Vec::new();
    store.backup(&mut archive).unwrap();
    store.rollback(1).unwrap();
    caught_up(&store);
    drop(store);
    assert_eq!(open(dir.path()).lineage(), lineage);
    std::fs::remove_dir_all(tiles_dir(dir.path())).unwrap();
    let store = open(dir.path());
    caught_up(&store);
    assert_eq!(store.lineage(), lineage);
    unpack(&archive, copy.path());
    assert_ne!(open(copy.path()).lineage(), lineage);
}

/// Breaks it: tiles that stay as another policy had them, or that keep their lineage.
#[test]
fn another_policy_folds_the_map_anew_and_is_of_another_lineage() {
    let dir = tempfile::tempdir().unwrap();
    let asking_for = |publish_contributors| {
        let policy = Policy { publish_contributors, ..Policy::trusting() };
        let store = EmbeddedStore::open(&Options { policy, ..options(dir.path()) }).unwrap();
        caught_up(&store);
        store
    };
    let store = asking_for(200);
    commit_all(&store, &some_uploads(3));
    caught_up(&store);
    assert_eq!(store.totals().cells, 0, "nobody has that many contributors");
    let lineage = store.lineage();
    drop(store);
    let store = asking_for(1);
    assert!(store.totals().cells > 0);
    let other = store.lineage();
    assert_ne!(other, lineage);
    drop(store);
    assert_eq!(asking_for(1).lineage(), other);
}

/// Catches: an update of the service that folds the map anew or gives it another lineage, because names in the code or the
/// way they are printed changed.
#[test]
fn a_manifest_of_the_format_before_keeps_lineage_and_generation() {
    let dir = tempfile::tempdir().unwrap();
    let vetted = mapping().policy();
    let with = |policy| EmbeddedStore::open(&Options { policy, ..options(dir.path()) }).unwrap();
    let store = with(vetted);
    commit_all(&store, &some_uploads(3));
    caught_up(&store);
    let lineage = store.lineage();
    drop(store);
    let marker = tiles_dir(dir.path()).join("marker");
    std::fs::write(&marker, "these tiles").unwrap();
    let manifest = dir.path().join("manifest");
    let current = std::fs::read(&manifest).unwrap();
    let legacy = map::manifest::legacy(&std::fs::read(&manifest).unwrap(), &vetted);
    std::fs::write(&manifest, legacy).unwrap();
    assert_ne!(std::fs::read(&manifest).unwrap(), current);
    let store = with(vetted);
    assert_eq!(store.progress().borrow().state, MapStatus::Serving, "nothing is folded anew");
    assert!(store.lineage() == lineage && marker.exists());
    assert_eq!(std::fs::read(&manifest).unwrap(), current, "it is rewritten");
    drop(store);

    let legacy = map::manifest::legacy(&std::fs::read(&manifest).unwrap(), &vetted);
    std::fs::write(&manifest, legacy).unwrap();
    let store = with(Policy { publish_contributors: 7, ..vetted });
    assert_ne!(store.lineage(), lineage);
    caught_up(&store);
    assert!(!marker.exists(), "under another policy the tiles are made anew");
    assert_eq!(std::fs::read(&manifest).unwrap()[..4], *b"EFM\x04");
}

/// Copies a directory with all in it.
pub(super) fn copy_dir(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_dir(&entry.path(), &to);
        } else {
            std::fs::copy(entry.path(), to).unwrap();
        }
    }
}

fn mapping() -> crate::mapping::MappingConfig {
    crate::mapping::MappingConfig::default()
}

#[test]
fn a_sound_store_is_verified_and_damage_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    TODAY.set(Some(100));
    commit_all(&store, &some_uploads(10));
    TODAY.set(Some(101));
    store.compact(101).unwrap();
    commit_all(&store, &some_uploads(20)[10..]);
    let tiles = map(&store).len() as u64;
    let found = store.verify(true).unwrap();
    assert_eq!((found.records, found.tiles, found.compared), (11, tiles, Some(tiles)));
    assert!(found.checkpoint_tiles > 0 && found.damage.is_empty(), "{found:?}");

    let newest = std::fs::read_dir(dir.path().join("journal")).unwrap().map(|e| e.unwrap().path()).max();
    let newest = newest.unwrap();
    let good = std::fs::read(&newest).unwrap();
    let mut bad = good.clone();
    *bad.last_mut().unwrap() ^= 1;
    std::fs::write(&newest, bad).unwrap();
    let found = store.verify(false).unwrap();
    assert!(found.damage.len() == 1 && found.damage[0].contains("journal"), "{found:?}");
    std::fs::write(&newest, good).unwrap();

    let checkpoint = dir.path().join("base-10");
    let mut bad = std::fs::read(&checkpoint).unwrap();
    bad[60] ^= 1;
    std::fs::write(&checkpoint, bad).unwrap();
    let found = store.verify(false).unwrap();
    assert!(found.damage.len() == 1 && found.damage[0].contains("base"), "{found:?}");
}

#[test]
fn a_tile_that_is_not_what_the_journal_says_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    commit_all(&store, &some_uploads(10));
    let (id, _) = map(&store).pop_first().unwrap();
    let served = store.shared.served().unwrap();
    let mut folded = Source::folded(&*served, id).unwrap();
    folded.tile = Tile::default();
    served.put([(id, folded)].into_iter(), &[], 10).unwrap();
    assert!(store.verify(false).unwrap().damage.is_empty(), "its checksum is right");
    let found = store.verify(true).unwrap();
    assert!(found.damage.len() == 1 && found.damage[0].contains(&id.to_string()), "{found:?}");
}
