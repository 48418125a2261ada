//! How many uploads a second does the store take, each on disk before it is answered, and how fast
//! does it fold? The same bytes are also written to a plain file, synced one by one, and to plain sled,
//! flushed one by one: what the disk itself allows, and what a key-value store makes of it.
//! `cargo run --release -p echofix-server --example commit_rate -- <directory>`
#![expect(clippy::print_stdout, reason = "it prints what it measures")]

use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use echofix_core::evidence::codec;
use echofix_core::evidence::{CellHits, EvidenceDelta, Pass, TileEvidence};
use echofix_core::geo::{TileId, Zone};
use echofix_server::store::{EmbeddedStore, MapStore, Options, Policy, UploadRecord};
use uuid::Uuid;

const TILES: i32 = 12;
const CELLS: u32 = 400;
const TIME: Duration = Duration::from_secs(5);
/// Uploads that are folded, to see how fast that is.
const FOLDED: u32 = 1000;

fn upload(zone: Zone, number: u32) -> UploadRecord {
    let hits = |i: u32| CellHits { index: i * 600 + number % 600, hits: 2, offset_sum: [100 + i % 99, 300] };
    // A drive through a neighbourhood of its own; every fiftieth drive is the same.
    let home = (number % 50) as i32 * TILES;
    let evidence = || TileEvidence::of_hits((0..CELLS).map(hits).collect());
    let tiles = (0..TILES).map(|x| (TileId { zone, y: 65_000, x: home + x }, evidence()));
    let contribution =
        EvidenceDelta { tiles: tiles.collect(), detections: u64::from(CELLS) * TILES as u64 * 2 };
    let pass = Pass { day: 20_000 + (number / 1000) as u16, contributor: u64::from(number) };
    UploadRecord {
        id: Uuid::now_v7(),
        pass,
        forget_before: 0,
        declared: None,
        contribution,
        answer: vec![7; 400],
    }
}

/// How often work can be done in a second.
fn rate(mut work: impl FnMut(u32) -> Result<(), Box<dyn Error>>) -> Result<f64, Box<dyn Error>> {
    let (began, mut done) = (Instant::now(), 0);
    while began.elapsed() < TIME {
        work(done)?;
        done += 1;
    }
    Ok(f64::from(done) / began.elapsed().as_secs_f64())
}

/// Uploads a second that a plain file and plain sled take, one at a time.
fn plain(dir: &Path, zone: Zone) -> Result<[f64; 2], Box<dyn Error>> {
    let bytes = |number| {
        let UploadRecord { contribution, answer, .. } = upload(zone, number);
        [codec::encode(&contribution), answer].concat()
    };
    let mut file = File::create(dir.join("plain"))?;
    let on_disk = rate(|number| {
        file.write_all(&bytes(number))?;
        Ok(file.sync_data()?)
    })?;
    let db = sled::open(dir.join("plain-sled"))?;
    let flushed = rate(|number| {
        db.insert(number.to_be_bytes(), bytes(number))?;
        db.flush()?;
        Ok(())
    })?;
    Ok([on_disk, flushed])
}

fn main() -> Result<(), Box<dyn Error>> {
    let data_dir = std::env::args_os().nth(1).map(PathBuf::from).ok_or("name a directory to measure in")?;
    let zone = Zone::from_epsg(32614)?;
    std::fs::create_dir_all(&data_dir)?;
    let beside = data_dir.join("plain-writes");
    std::fs::create_dir_all(&beside)?;
    let [file, flushed] = plain(&beside, zone)?;
    std::fs::remove_dir_all(&beside)?;
    println!("one at a time: a plain file with fdatasync {file:.0}/s, plain sled with flush {flushed:.0}/s");
    for threads in [1, 4, 16, 64] {
        let per_s = committed(&data_dir, zone, threads)?;
        println!(
            "{threads} at once: {per_s:.0} uploads/s on disk, {:.2} times the file's, {:.2} times sled's",
            per_s / file,
            per_s / flushed
        );
    }
    println!("folded: {:.0} uploads/s", folded(&data_dir, zone)?);
    Ok(())
}

/// A store of its own, removed with what it holds afterwards. It takes uploads without vetting them.
fn with_store<T>(data_dir: &Path, work: impl FnOnce(&EmbeddedStore) -> T) -> Result<T, Box<dyn Error>> {
    let data_dir = data_dir.join("store");
    let options = Options::new(data_dir.clone(), Policy::trusting());
    let done = work(&EmbeddedStore::open(&options)?);
    std::fs::remove_dir_all(data_dir)?;
    Ok(done)
}

/// Uploads a second that so many threads bring onto the disk, folding going on meanwhile.
fn committed(data_dir: &Path, zone: Zone, threads: u32) -> Result<f64, Box<dyn Error>> {
    with_store(data_dir, |store| {
        let began = Instant::now();
        std::thread::scope(|scope| {
            let commit = |thread: u32| {
                let mut number = thread * 100_000;
                while began.elapsed() < TIME {
                    store.commit(upload(zone, number)).expect("the disk takes it");
                    number += 1;
                }
            };
            (0..threads).for_each(|thread| drop(scope.spawn(move || commit(thread))));
        });
        store.progress().borrow().journaled as f64 / began.elapsed().as_secs_f64()
    })
}

/// Uploads a second that one thread folds into tiles.
fn folded(data_dir: &Path, zone: Zone) -> Result<f64, Box<dyn Error>> {
    with_store(data_dir, |store| {
        let began = Instant::now();
        (0..FOLDED).for_each(|number| drop(store.commit(upload(zone, number)).expect("the disk takes it")));
        let progress = store.progress();
        while progress.borrow().epoch < u64::from(FOLDED) {
            std::thread::sleep(Duration::from_millis(5));
        }
        f64::from(FOLDED) / began.elapsed().as_secs_f64()
    })
}
