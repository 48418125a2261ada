//! The store as a whole, against a model that folds in memory.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use echofix_core::datum::Offset;
use echofix_core::evidence::Cell;
use echofix_core::geo::TileId;
use echofix_core::tile::{self, Ledger, Tile};
use proptest::prelude::*;
use uuid::Uuid;

use super::backend::faulty::{Call, Fault, Faults};
use super::backend::tables::TableUse;
use super::*;
use crate::store::testing::{some_uploads, uploads};

mod compacting;
mod controls;
mod copies;
mod faults;
mod folding;
mod losses;
mod past;
mod replicated;

thread_local! {
    /// What a test says the day is, for calls of its own thread.
    static TODAY: std::cell::Cell<Option<u16>> = const { std::cell::Cell::new(None) };
}

/// A small cache, small segments, and a write buffer that is full at once.
fn options(dir: &Path) -> Options {
    let usual = Options::new(dir.to_owned(), Policy::trusting());
    let system = usual.clock.clone();
    let clock = StoreClock::new(move || {
        TODAY.get().map_or_else(|| system.now_us(), |day| i64::from(day) * echofix_core::time::DAY_US)
    });
    Options { cache_bytes: 8 << 20, segment_bytes: 4096, write_buffer_tiles: 3, clock, ..usual }
}

fn open(dir: &Path) -> EmbeddedStore {
    EmbeddedStore::open(&options(dir)).unwrap()
}

/// A store in a directory whose calls may fail.
fn open_failing(dir: &Path, faults: &Faults) -> EmbeddedStore {
    let options = options(dir);
    let backend = local::open(dir, options.table, options.cache_bytes).unwrap();
    EmbeddedStore::over(faults.around(backend), options.settings()).unwrap()
}

/// Waits until the making of a generation stopped, or only what comes after it did: then the tiles that were served
/// before are gone, too.
fn wait_for_fault(store: &EmbeddedStore, faults: &Faults, dir: &Path) {
    wait_for(store, |p| {
        let made = p.state == MapStatus::Serving && p.epoch == p.journaled && p.building.is_none();
        faults.injected() > 0 && (p.state == MapStatus::Stalled || (made && tiles_dirs(dir).len() == 1))
    });
}

fn commit_all(store: &EmbeddedStore, uploads: &[UploadRecord]) {
    for upload in uploads {
        store.commit(upload.clone()).unwrap();
    }
}

/// The directories of tiles.
fn tiles_dirs(dir: &Path) -> Vec<PathBuf> {
    let named = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().starts_with("tiles-");
    std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).filter(named).collect()
}

/// The directory of the tiles that are served.
fn tiles_dir(dir: &Path) -> PathBuf {
    let mut all = tiles_dirs(dir);
    assert_eq!(all.len(), 1, "{all:?}");
    all.remove(0)
}

/// Waits until everything in the journal is folded.
fn caught_up(store: &EmbeddedStore) {
    wait_for(store, |p| p.state == MapStatus::Serving && p.epoch == p.journaled && p.building.is_none());
}

fn wait_for(store: &EmbeddedStore, done: impl Fn(MapProgress) -> bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !done(*store.progress().borrow()) {
        assert!(Instant::now() < deadline, "{:?}", *store.progress().borrow());
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Versions and bytes of all tiles, once all is folded.
fn map(store: &EmbeddedStore) -> BTreeMap<TileId, (u64, Vec<u8>)> {
    caught_up(store);
    map_of_now(store)
}

/// Versions and bytes of all tiles.
fn map_of_now(store: &EmbeddedStore) -> BTreeMap<TileId, (u64, Vec<u8>)> {
    let all = i32::MIN..=i32::MAX;
    let infos =
        store.zones().into_iter().flat_map(|zone| store.catalog(zone, all.clone(), all.clone()).unwrap());
    let tiles = infos.map(|info| {
        let tile = store.tile(info.id).unwrap().unwrap();
        assert_eq!((info.version, info.cells as usize), (tile.version, tile.tile.len()));
        (info.id, (tile.version, tile.encoded()))
    });
    tiles.collect()
}

/// What the map must be.
fn model(uploads: &[UploadRecord]) -> BTreeMap<TileId, (u64, Vec<u8>)> {
    let mut tiles: BTreeMap<TileId, (u64, Tile, Ledger)> = BTreeMap::new();
    for (number, upload) in (1..).zip(uploads) {
        for (id, evidence) in &upload.contribution.tiles {
            let (version, tile, ledger) = tiles.entry(*id).or_default();
            let sigma = upload.declared.unwrap_or_default();
            tile.fold_moved(ledger, upload.pass, evidence, Offset::default(), sigma);
            *version = number;
        }
    }
    tiles.into_iter().map(|(id, (version, tile, _))| (id, (version, tile::encode(&tile)))).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn commits_and_reopens_follow_the_model(
        steps in prop::collection::vec((uploads(), 0..4_u8), 1..20),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let mut store = open(dir.path());
        let mut counted: Vec<UploadRecord> = Vec::new();
        for (upload, then) in steps {
            let receipt = store.commit(upload.clone()).unwrap();
            counted.push(upload);
            prop_assert_eq!(receipt, Receipt::Counted { epoch: counted.len() as u64 });
            match then {
                0 => {
                    drop(store);
                    store = open(dir.path());
                }
                1 => {
                    let earlier = &counted[counted.len() / 2];
                    let epoch = counted.len() as u64 / 2 + 1;
                    let duplicate = Receipt::Duplicate { epoch, answer: earlier.answer.clone() };
                    prop_assert_eq!(store.commit(earlier.clone()).unwrap(), duplicate.clone());
                    prop_assert_eq!(store.counted(earlier.id).unwrap(), Some(duplicate));
                }
                2 => prop_assert_eq!(map(&store), model(&counted)),
                _ => {}
            }
        }
        prop_assert_eq!(map(&store), model(&counted));
        prop_assert_eq!(store.totals().uploads, counted.len() as u64);
    }
}

/// A store takes uploads, folds them and ends.
fn folded_and_closed(dir: &Path, uploads: &[UploadRecord]) {
    let store = open(dir);
    commit_all(&store, uploads);
    caught_up(&store);
}

#[test]
fn deleted_tiles_are_rebuilt_to_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let uploads = some_uploads(60);
    let store = open(dir.path());
    commit_all(&store, &uploads);
    let before = map(&store);
    drop(store);
    std::fs::remove_dir_all(tiles_dir(dir.path())).unwrap();
    assert_eq!(map(&open(dir.path())), before);
    assert_eq!(before, model(&uploads));
}

#[test]
fn tiles_that_cannot_be_opened_are_rebuilt() {
    let dir = tempfile::tempdir().unwrap();
    let uploads = some_uploads(20);
    folded_and_closed(dir.path(), &uploads);
    for file in ["conf", "db"] {
        std::fs::write(tiles_dir(dir.path()).join(file), [0xa5; 9000]).unwrap();
        assert_eq!(map(&open(dir.path())), model(&uploads), "{file}");
    }
}

/// Catches: a damaged table that is taken for a disk that may come back, and waited for until somebody removes it.
#[test]
fn tiles_in_redb_that_cannot_be_opened_are_rebuilt() {
    let dir = tempfile::tempdir().unwrap();
    let uploads = some_uploads(20);
    let open = || EmbeddedStore::open(&Options { table: TableEngine::Redb, ..options(dir.path()) }).unwrap();
    let store = open();
    commit_all(&store, &uploads);
    assert_eq!(map(&store), model(&uploads));
    drop(store);
    for damage in [&[0xa5; 9000][..], &[0xa5; 3], &[]] {
        let table = std::fs::read_dir(tiles_dir(dir.path())).unwrap().map(|entry| entry.unwrap().path());
        let table = table.max_by_key(|path| std::fs::metadata(path).unwrap().len()).unwrap();
        std::fs::write(table, damage).unwrap();
        assert_eq!(map(&open()), model(&uploads), "{} bytes", damage.len());
    }
}

/// Breaks it: ending the start with sled's refusal.
#[test]
fn tiles_that_an_older_version_stored_in_another_layout_are_rebuilt() {
    let dir = tempfile::tempdir().unwrap();
    let uploads = some_uploads(20);
    folded_and_closed(dir.path(), &uploads);
    let tiles = tiles_dir(dir.path());
    std::fs::remove_dir_all(&tiles).unwrap();
    let older = sled::Config::new().path(&tiles).segment_size(4 << 20).open().unwrap();
    older.open_tree("tiles").unwrap().insert([0; 10], "a whole tile").unwrap();
    drop(older);
    assert_eq!(map(&open(dir.path())), model(&uploads));
}

#[test]
fn tiles_of_another_table_are_folded_anew() {
    let dir = tempfile::tempdir().unwrap();
    let uploads = some_uploads(20);
    let tables = [TableEngine::Sled, TableEngine::Redb, TableEngine::Redb, TableEngine::Sled];
    for (table, sent) in tables.into_iter().zip([5, 10, 15, 20]) {
        let store = EmbeddedStore::open(&Options { table, ..options(dir.path()) }).unwrap();
        commit_all(&store, &uploads[sent - 5..sent]);
        assert_eq!(map(&store), model(&uploads[..sent]), "{table:?}");
        assert_eq!(store.verify(true).unwrap().damage, [""; 0]);
    }
}

#[test]
fn tiles_of_another_journal_are_not_believed() {
    let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let uploads = some_uploads(8);
    for (dir, range) in [(&here, 0..3), (&there, 3..8)] {
        let store = open(dir.path());
        commit_all(&store, &uploads[range]);
        caught_up(&store);
    }
    let ours = tiles_dir(here.path());
    std::fs::remove_dir_all(&ours).unwrap();
    std::fs::rename(tiles_dir(there.path()), ours).unwrap();
    assert_eq!(map(&open(here.path())), model(&uploads[..3]));
}

#[test]
fn a_tile_that_sled_rolled_back_or_lost_is_folded_again() {
    let dir = tempfile::tempdir().unwrap();
    let uploads = some_uploads(30);
    let store = open(dir.path());
    commit_all(&store, &uploads[..10]);
    caught_up(&store);
    drop(store);
    let old: Vec<_> = sled_tree(dir.path(), |tree| tree.iter().map(Result::unwrap).collect());
    let store = open(dir.path());
    commit_all(&store, &uploads[10..]);
    caught_up(&store);
    drop(store);
    sled_tree(dir.path(), |tree| {
        for (i, (key, value)) in old.iter().enumerate() {
            match i % 3 {
                0 => drop(tree.insert(key, value).unwrap()),
                1 => drop(tree.remove(key).unwrap()),
                _ => drop(tree.insert(key, &value[..value.len() / 2]).unwrap()),
            }
        }
        tree.insert("stray", "value").unwrap();
    });
    assert_eq!(map(&open(dir.path())), model(&uploads));
}

fn sled_tree<T>(dir: &Path, work: impl FnOnce(&sled::Tree) -> T) -> T {
    let tiles = local::sled_instance::Sled::open(&tiles_dir(dir), 1 << 20).unwrap();
    let result = work(tiles.tree());
    tiles.db().flush().unwrap();
    result
}

/// Catches: a crash that keeps the map from being read until all that was journaled is folded.
#[test]
fn the_last_good_epoch_is_served_while_the_rest_is_folded() {
    let (dir, old) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let uploads = some_uploads(400);
    let store = open(dir.path());
    commit_all(&store, &uploads[..10]);
    let before = map(&store);
    drop(store);
    copies::copy_dir(&tiles_dir(dir.path()), &old.path().join("tiles"));
    let store = open(dir.path());
    commit_all(&store, &uploads[10..]);
    let after = map(&store);
    drop(store);
    // As after a crash that took back what sled had not synced.
    let tiles = tiles_dir(dir.path());
    std::fs::remove_dir_all(&tiles).unwrap();
    std::fs::rename(old.path().join("tiles"), tiles).unwrap();
    let store = open(dir.path());
    let progress = *store.progress().borrow();
    assert_eq!(progress.state, MapStatus::Serving);
    assert_eq!(progress.journaled, 400);
    let (id, (version, _)) = before.iter().next().unwrap();
    let served = store.tile(*id).unwrap().unwrap();
    assert!(served.version >= *version, "what is served is not older than it was");
    assert_eq!(map(&store), after);
}

#[test]
fn one_id_from_many_threads_at_once_counts_once() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = some_uploads(8);
    let counted = std::thread::scope(|scope| {
        let send = || uploads.iter().map(|upload| store.commit(upload.clone()).unwrap()).collect::<Vec<_>>();
        let threads: Vec<_> = (0..8).map(|_| scope.spawn(send)).collect();
        let receipts: Vec<_> = threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect();
        receipts.into_iter().filter(|receipt| matches!(receipt, Receipt::Counted { .. })).count()
    });
    assert_eq!(counted, 8);
    assert_eq!(map(&store).len(), model(&uploads).len());
    assert_eq!(store.totals().uploads, 8);
}

#[test]
fn the_order_of_uploads_changes_versions_and_presence_only() {
    let mut uploads = some_uploads(20);
    let evidence = |uploads: &[UploadRecord]| -> Vec<_> {
        let dir = tempfile::tempdir().unwrap();
        let store = open(dir.path());
        commit_all(&store, uploads);
        let tile = |(id, (_, bytes)): (TileId, (u64, Vec<u8>))| {
            let tile = tile::decode(&bytes).unwrap();
            let cells = tile.cells().iter().map(|(index, cell)| (*index, Cell { presence: 0, ..*cell }));
            (id, cells.collect::<Vec<_>>(), *tile.observed(), *tile.support())
        };
        map(&store).into_iter().map(tile).collect()
    };
    let forward = evidence(&uploads);
    uploads.reverse();
    assert!(evidence(&uploads) == forward);
}

#[test]
fn forgetting_is_part_of_the_journal_and_rebuilds_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let mut uploads = some_uploads(30);
    for (i, upload) in (0_u16..).zip(&mut uploads) {
        upload.pass.day = 20_000 + i / 5;
        upload.forget_before = upload.pass.day - 2;
        store.commit(upload.clone()).unwrap();
    }
    let before = map(&store);
    drop(store);
    sled_tree(dir.path(), |tree| tree.clear().unwrap());
    assert_eq!(map(&open(dir.path())), before);
}

#[test]
fn nothing_is_answered_from_a_map_that_is_being_rebuilt() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = some_uploads(400);
    commit_all(&store, &uploads);
    let whole = map(&store);
    drop(store);
    std::fs::remove_dir_all(tiles_dir(dir.path())).unwrap();
    let store = open(dir.path());
    let mut refusals = 0;
    loop {
        match store.tile(*whole.keys().next().unwrap()) {
            Err(Error::Rebuilding { journaled: 400, .. }) => refusals += 1,
            Ok(Some(tile)) => {
                assert_eq!(whole[whole.keys().next().unwrap()], (tile.version, tile.encoded()));
                break;
            }
            other => panic!("{other:?}"),
        }
    }
    assert!(refusals > 0);
}

#[test]
fn a_data_directory_names_its_uploads_once() {
    let ids: HashSet<_> = some_uploads(50).into_iter().map(|upload| upload.id).collect();
    assert_eq!(ids.len(), 50, "the generator must not repeat ids, or the tests above prove less");
}
