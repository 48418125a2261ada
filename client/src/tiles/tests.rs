//! The cache without a network: what a sync does to the disk, and what crashes and damage leave.

use echofix_core::evidence::Cell;
use echofix_core::geo::Zone;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use tempfile::TempDir;

use super::*;

fn id(x: i32) -> TileId {
    TileId { zone: Zone::from_epsg(32614).unwrap(), y: 65_000, x: 12_000 + x }
}

/// A tile that knows its number.
fn encoded(number: u32) -> Vec<u8> {
    let cell = Cell { hits: number, passes: 1, ..Cell::default() };
    tile::encode(&Tile::from_cells(vec![(number, cell)]).unwrap())
}

/// Bytes of each of these tiles.
const BYTES: u64 = 38;

fn open(dir: &TempDir) -> TileCache {
    open_with(dir, u64::MAX)
}

fn open_with(dir: &TempDir, max_bytes: u64) -> TileCache {
    TileCache::open(dir.path(), TileCacheLimits { max_bytes }).unwrap()
}

fn put(cache: &TileCache, x: i32, version: u64) {
    let since = cache.inner.index().tick();
    put_since(cache, x, version, since).unwrap();
}

fn put_since(cache: &TileCache, x: i32, version: u64, since: u64) -> Result<u32, Error> {
    cache.inner.put(TileVersionName { id: id(x), version, form: Form::Tile }, &encoded(version as u32), since)
}

fn hits(cache: &TileCache, x: i32) -> Option<(u64, u32)> {
    cache.tile(id(x)).unwrap().map(|(version, tile)| (version, tile.cells()[0].1.hits))
}

fn held(cache: &TileCache) -> Vec<i32> {
    cache.versions().iter().map(|(id, _)| id.x - 12_000).collect()
}

fn files_of(dir: &TempDir) -> usize {
    fs::read_dir(dir.path().join("32614")).unwrap().count()
}

/// Breaks when a tile is lost over a restart, an older version stays, or somebody else may write at the same time.
#[test]
fn tiles_outlive_a_restart_and_newer_versions_replace_older_ones() {
    let dir = tempfile::tempdir().unwrap();
    let cache = open(&dir);
    assert!(matches!(TileCache::open(dir.path(), TileCacheLimits::default()), Err(Error::InUse { .. })));
    put(&cache, 1, 4);
    put(&cache, -2, 5);
    put(&cache, 1, 9);
    assert_eq!(cache.bytes(), 2 * BYTES);
    drop(cache);
    let cache = open(&dir);
    assert_eq!((hits(&cache, 1), hits(&cache, -2), hits(&cache, 3)), (Some((9, 9)), Some((5, 5)), None));
    assert_eq!((cache.bytes(), files_of(&dir)), (2 * BYTES, 2));
    assert!(cache.inner.remove(id(1)).unwrap() && !cache.inner.remove(id(1)).unwrap());
    assert_eq!((held(&open_again(cache, &dir)), files_of(&dir)), (vec![-2], 1));
}

fn open_again(cache: TileCache, dir: &TempDir) -> TileCache {
    drop(cache);
    open(dir)
}

/// Breaks when what a crash leaves is taken for a tile or stays for ever: a file half written, or both versions.
#[test]
fn what_a_crash_leaves_is_removed() {
    let dir = tempfile::tempdir().unwrap();
    let cache = open(&dir);
    put(&cache, 1, 4);
    let older =
        fs::read(TileVersionName { id: id(1), version: 4, form: Form::Tile }.path(dir.path())).unwrap();
    put(&cache, 1, 5);
    drop(cache);
    let zone = dir.path().join("32614");
    fs::write(zone.join("12001_65000_6.part"), &older[..9]).unwrap();
    fs::write(TileVersionName { id: id(1), version: 4, form: Form::Tile }.path(dir.path()), &older).unwrap();
    fs::write(zone.join("notes.txt"), "not ours").unwrap();
    let cache = open(&dir);
    // Either version is sound, and corrected by the next sync; but only one is there.
    assert!([Some((4, 4)), Some((5, 5))].contains(&hits(&cache, 1)));
    assert_eq!((cache.bytes(), files_of(&dir)), (BYTES, 2));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Breaks when damage is read as a tile, or is not offered to be fetched again.
    #[test]
    fn damage_is_noticed_and_the_tile_forgotten(at in any::<prop::sample::Index>(), bit in 0..8, cut in any::<bool>()) {
        let dir = tempfile::tempdir().unwrap();
        let cache = open(&dir);
        put(&cache, 1, 4);
        put(&cache, 2, 4);
        let path = TileVersionName { id: id(1), version: 4, form: Form::Tile }.path(dir.path());
        let mut bytes = fs::read(&path).unwrap();
        let at = at.index(bytes.len());
        bytes[at] ^= 1_u8 << bit;
        if cut {
            bytes.truncate(at);
        }
        fs::write(&path, bytes).unwrap();
        prop_assert_eq!((hits(&cache, 1), cache.version(id(1)), hits(&cache, 2)), (None, None, Some((4, 4))));
        prop_assert_eq!((cache.bytes(), path.exists()), (BYTES, false));
        put(&cache, 1, 4);
        fs::remove_file(&path).unwrap();
        prop_assert_eq!((hits(&cache, 1), cache.version(id(1))), (None, None));
    }

    /// Breaks when the count of bytes drifts, the limit is exceeded, or a tile is lost or comes back from the dead:
    /// the cache is compared with a plain list of what must be there, over restarts.
    #[test]
    fn the_cache_is_what_was_put_and_used(steps in prop::collection::vec((0..6_i32, 1..50_u64, 0..8_u8), 1..40)) {
        let dir = tempfile::tempdir().unwrap();
        let mut cache = open_with(&dir, 3 * BYTES);
        // The tiles, by the order of their use.
        let mut expected: Vec<(i32, u64)> = Vec::new();
        for (x, version, what) in steps {
            let before = expected.iter().position(|(held, _)| *held == x);
            match what {
                0 => {
                    drop(cache);
                    cache = open_with(&dir, 3 * BYTES);
                }
                1 => {
                    cache.inner.remove(id(x)).unwrap();
                    before.map(|at| expected.remove(at));
                }
                2 | 3 => {
                    let entry = before.map(|at| expected.remove(at));
                    expected.extend(entry);
                    prop_assert_eq!(hits(&cache, x).map(|(version, _)| version), entry.map(|(_, version)| version));
                }
                _ => {
                    put(&cache, x, version);
                    before.map(|at| expected.remove(at));
                    expected.push((x, version));
                    if expected.len() > 3 {
                        expected.remove(0);
                    }
                }
            }
            let have: BTreeMap<_, _> = cache.versions().into_iter().collect();
            prop_assert_eq!(have, expected.iter().map(|(x, version)| (id(*x), *version)).collect());
            prop_assert_eq!(cache.bytes(), BYTES * expected.len() as u64);
        }
    }
}

/// Breaks when a sync throws out what it has just fetched, or a lowered limit is not respected.
#[test]
fn what_does_not_fit_is_told_and_lower_limits_hold() {
    let dir = tempfile::tempdir().unwrap();
    let cache = open_with(&dir, 2 * BYTES);
    put(&cache, 1, 4);
    let since = cache.inner.index().tick();
    assert_eq!(put_since(&cache, 2, 4, since).unwrap(), 0);
    assert_eq!(put_since(&cache, 3, 4, since).unwrap(), 1);
    let error = put_since(&cache, 4, 4, since).unwrap_err();
    assert!(matches!(error, Error::Full { .. }) && error.to_string().contains("raise the limit"), "{error}");
    // Its own older version is no obstacle.
    assert_eq!(put_since(&cache, 3, 5, since).unwrap(), 0);
    assert_eq!(held(&cache), [2, 3]);
    assert!(hits(&cache, 2).is_some());
    drop(cache);
    assert_eq!(held(&open_with(&dir, BYTES)), [2], "the one read last");
}
