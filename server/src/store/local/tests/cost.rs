//! What each table costs: `cargo test -p echofix-server --lib cost_of_sled -- --ignored --nocapture`, and the same
//! for `cost_of_redb`: one at a time, since memory is the process's.

use std::fs;
use std::time::{Duration, Instant};

use uuid::Uuid;

use super::*;
use crate::store::backend::tables::{Batch, TableId, TableUse, TileTable};

const TILES: u64 = 3000;
/// Bytes of a piece, of which each tile has two, as the map's tiles are cut.
const PIECE: usize = 16_000;
/// How often each tile is written.
const ROUNDS: u64 = 4;
const BATCH: u64 = 64;
const CACHE: u64 = 8 << 20;

/// Bytes that cannot be compressed.
fn noise(seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let next = |_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 56) as u8
    };
    (0..PIECE).map(next).collect()
}

/// The process's own memory, MB.
fn memory_mb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<f64>().unwrap() / 1e3
}

fn bytes_below(dir: &Path) -> u64 {
    let entries = fs::read_dir(dir).unwrap().map(Result::unwrap);
    let bytes = |entry: fs::DirEntry| match entry.metadata().unwrap() {
        dir if dir.is_dir() => bytes_below(&entry.path()),
        file => file.len(),
    };
    entries.map(bytes).sum()
}

fn batch(round: u64, first: u64) -> Batch {
    let mut batch = Batch::default();
    for tile in first..(first + BATCH).min(TILES) {
        // Neighbours do not come together.
        let key = (tile.wrapping_mul(0x9e37_79b9) % (1 << 32)).to_be_bytes();
        for piece in 0..2_u8 {
            batch.put(&[&key[..], &[piece]].concat(), &noise((round << 32) | (tile << 1) | u64::from(piece)));
        }
    }
    batch
}

/// Writes all tiles some times over; how long each batch took, in order.
fn written(table: &dyn TileTable) -> Vec<Duration> {
    let mut times = Vec::new();
    for round in 0..ROUNDS {
        for first in (0..TILES).step_by(BATCH as usize) {
            let batch = batch(round, first);
            let began = Instant::now();
            table.apply(batch).unwrap();
            times.push(began.elapsed());
        }
    }
    times.sort_unstable();
    times
}

fn cost_of(engine: TableEngine) {
    let dir = tempfile::tempdir().unwrap();
    let id = TableId { used: TableUse::Served, number: 1 };
    let backend = open(dir.path(), engine, CACHE).unwrap();
    let before = memory_mb();
    let table = backend.tables.create(id, Uuid::nil()).unwrap();
    let times = written(&*table);
    let after_writing = memory_mb() - before;
    drop(table);
    let after_closing = memory_mb() - before;
    let stored = TILES * 2 * (PIECE as u64 + 9);
    let on_disk = bytes_below(&dir.path().join("tiles-1"));
    let began = Instant::now();
    let table = backend.tables.open(id).unwrap().unwrap();
    let opened = began.elapsed();
    let read = table.scan(b"").map(Result::unwrap).count() as u64;
    assert_eq!(read, 2 * TILES);
    eprintln!(
        "{engine:?}: {:.0} MB stored, {:.2} times that on disk; memory: {after_writing:.0} MB after writing, \
         {after_closing:.0} MB after closing, {:.0} MB after opening and reading all; a batch of {BATCH} tiles: {:?} in \
         the middle, {:?} at most; opening {opened:?}, with reading {:?}",
        stored as f64 / 1e6,
        on_disk as f64 / stored as f64,
        memory_mb() - before,
        times[times.len() / 2],
        times[times.len() - 1],
        began.elapsed(),
    );
}

#[test]
#[ignore = "measures"]
fn cost_of_sled() {
    cost_of(TableEngine::Sled);
}

#[test]
#[ignore = "measures"]
fn cost_of_redb() {
    cost_of(TableEngine::Redb);
}
