//! Every parser of foreign bytes, fed with sound bytes that were changed: no panic, a typed error, little memory.
//!
//! Each target runs for some seconds, for more with `ECHOFIX_FUZZ_S`. What it starts from are the corpus (`tests/corpus/<target>/`,
//! one file an input) and what the crates write themselves. An input that fails is kept in the temporary directory, under the
//! name that the failure tells; put it into the corpus once it is mended.
//!
//! - [`counted`]: an allocator that counts.
//! - [`mutation`]: sound bytes, changed, with their checksums made to match.

#![expect(unsafe_code, reason = "an allocator that counts is an allocator")]

#[path = "../../../core/tests/counted/mod.rs"]
mod counted;
mod mutation;

use std::fs;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use counted::{Counting, peak};
use echofix_client::drivelog;
use echofix_client::upload::spool::{Spool, SpoolLimits};
use echofix_core::drive::Drive;
use echofix_core::evidence::codec::{self, DeltaLimits};
use echofix_core::tile::{self, Grain};
use echofix_proto::v1::{LocalizeRequest, UploadRequest};
use echofix_server::args::ServeArgs;
use echofix_server::grpc::LocalizationApi;
use echofix_server::locating::Locator;
use echofix_server::store::{EmbeddedStore, MapStore, Operations, Options, Region};
use echofix_tests::asking;
use echofix_tests::{mapping, town, until_blocking};
use mutation::{Mutator, Seal};
use prost::Message;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use tonic::Code;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Bytes that an input may take beyond its own.
const MOST: isize = 16 << 20;
/// Bytes of an input, at most.
const LARGEST: usize = 1 << 20;
/// The one segment of the fixture's journal.
const JOURNAL: &str = "journal/00000000000000000001.seg";

/// What a target does with an input: how it fails is said in words.
type Target<'a> = &'a mut dyn FnMut(&[u8]) -> Result<(), String>;

/// Feeds a target for its time.
fn fuzz(name: &str, seal: Seal, sound: Vec<Vec<u8>>, target: Target<'_>) {
    let seconds =
        std::env::var("ECHOFIX_FUZZ_S").map_or(2, |s| s.parse().expect("ECHOFIX_FUZZ_S is a number"));
    let mut corpus = kept(name);
    let known = corpus.len();
    corpus.extend(sound);
    assert!(!corpus.is_empty(), "there is nothing to start from");
    for input in &corpus {
        feed(name, input, target);
    }
    let seed = town::seed();
    let mut mutator = Mutator::new(ChaCha8Rng::seed_from_u64(seed), seal);
    let (began, mut fed) = (Instant::now(), 0_u64);
    while began.elapsed() < Duration::from_secs(seconds) {
        let mut input = mutator.changed(&corpus);
        input.truncate(LARGEST);
        feed(name, &input, target);
        fed += 1;
    }
    assert!(fed > 10, "{name}: only {fed} inputs");
    eprintln!(
        "{name}: {fed} inputs from {known} of the corpus and {} written now, seed {seed}",
        corpus.len() - known
    );
}

fn feed(name: &str, input: &[u8], target: Target<'_>) {
    let (outcome, taken) = peak(|| catch_unwind(AssertUnwindSafe(|| target(input))));
    let complaint = match outcome {
        Err(_) => "it panics".to_owned(),
        Ok(Err(complaint)) => complaint,
        Ok(Ok(())) if taken > MOST + 2 * input.len() as isize => format!("it takes {taken} bytes"),
        Ok(Ok(())) => return,
    };
    let path = std::env::temp_dir().join(format!("echofix-{name}-{:08x}", crc32c::crc32c(input)));
    fs::write(&path, input).expect("the input can be kept");
    panic!("{name}: {complaint}, with {} bytes: {}", input.len(), path.display());
}

/// The inputs of the corpus.
fn kept(name: &str) -> Vec<Vec<u8>> {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(name);
    let mut paths: Vec<PathBuf> = fs::read_dir(&dir)
        .into_iter()
        .flatten()
        .map(|entry| entry.expect("it can be listed").path())
        .collect();
    paths.sort();
    paths.iter().map(|path| fs::read(path).expect("it can be read")).collect()
}

/// Some seconds of a drive.
fn drive() -> Drive {
    town::wander(&town::town(town::seed()), 0, "mapper", town::seed(), 30.0)
}

fn fixture(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/v0.1").join(path)
}

fn tiles() -> Vec<Vec<u8>> {
    let dir = fs::read_dir(fixture("tiles/32614")).expect("the fixture is there");
    dir.map(|entry| fs::read(entry.expect("it can be listed").path()).expect("it can be read")).collect()
}

/// Catches: evidence that panics, or that takes more than its bytes can stand for.
#[test]
fn evidence() {
    let limits = DeltaLimits { tiles: 4_096, cells: 500_000 };
    let uploads = mapping::uploads(&drive());
    let sound: Vec<_> =
        uploads.iter().filter_map(|upload| Some(codec::encode(&upload.evidence().ok()?))).collect();
    fuzz("evidence", Seal::Sealed, sound, &mut |input| {
        if let Ok(delta) = codec::decode_within(input, limits) {
            let cells: usize = delta.tiles.values().map(|tile| tile.cells.len()).sum();
            if cells > limits.cells || delta.tiles.len() > limits.tiles {
                return Err(format!("{cells} cells in {} tiles", delta.tiles.len()));
            }
        }
        Ok(())
    });
}

/// Catches: tiles, layers and ledgers that panic or take memory that their bytes do not stand for; a tile that is read and written as another one.
#[test]
fn tile_layer_and_ledger() {
    fuzz("tile", Seal::Sealed, tiles(), &mut |input| {
        if let Ok(read) = tile::decode(input)
            && tile::decode(&tile::encode(&read)).ok() != Some(read)
        {
            return Err("it is written as another one".to_owned());
        }
        Ok(())
    });
    let layer = |tile: &Vec<u8>| {
        let tile = tile::decode(tile).expect("the fixture is sound");
        [Grain::VEHICLE, Grain { side: 1, steps: 15, kept: 1.0 }]
            .map(|grain| tile::encode_layer(&tile, &grain))
    };
    fuzz("layer", Seal::Sealed, tiles().iter().flat_map(layer).collect(), &mut |input| {
        let _ = tile::decode_layer(input);
        Ok(())
    });
    let ledger = tile::encode_ledger(&tile::Ledger::default());
    fuzz("ledger", Seal::Sealed, vec![ledger], &mut |input| {
        let _ = tile::decode_ledger(input);
        Ok(())
    });
}

/// Catches: files of a spool that panic, or are sent as something that they are not.
#[test]
fn spool_entry() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let spool = Spool::open(folder.path(), SpoolLimits::default()).expect("a spool can be opened");
    let upload = mapping::uploads(&drive()).remove(0);
    spool.push(&upload).expect("it is kept");
    let is_file =
        |path: &PathBuf| path.is_file() && path.to_string_lossy().contains(&upload.id().to_string());
    let entries =
        fs::read_dir(folder.path()).expect("it can be listed").map(|entry| entry.expect("listed").path());
    let path = entries.into_iter().find(is_file).expect("the entry has a file");
    let sound = fs::read(&path).expect("it can be read");
    fuzz("spool", Seal::Spooled, vec![sound], &mut |input| {
        fs::write(&path, input).expect("it can be written");
        match spool.read(upload.id()) {
            Ok(Some(read)) if read.id() != upload.id() => Err("it is another upload".to_owned()),
            Ok(_) | Err(_) => Ok(()),
        }
    });
}

/// Catches: drive logs that panic, take much memory, or hold numbers that are none.
#[test]
fn drive_logs() {
    let mut short = drive();
    let until_us = short.scans.first().map_or(0, |scan| scan.time_us + 1_000_000);
    short.scans.retain(|scan| scan.time_us < until_us);
    let folder = tempfile::tempdir().expect("a folder can be made");
    let log = folder.path().join("drive.mcap");
    drivelog::write(&log, &short).expect("it is written");
    let sound = fs::read(&log).expect("it can be read");
    let finite =
        |drive: &Drive| drive.scans.iter().all(|scan| scan.range_m.iter().all(|range| range.is_finite()));
    let read = |path: &Path| match drivelog::read(path) {
        Ok(read) if !finite(&read.drive) => Err("a range is no number".to_owned()),
        Ok(_) | Err(_) => Ok(()),
    };
    fuzz("mcap", Seal::None, vec![sound], &mut |input| {
        fs::write(&log, input).expect("it can be written");
        read(&log)
    });
    let tables = folder.path().join("tables");
    drivelog::write(&tables, &short).expect("it is written");
    let files: Vec<PathBuf> =
        fs::read_dir(&tables).expect("it can be listed").map(|entry| entry.expect("listed").path()).collect();
    for path in files.iter().filter(|path| path.extension().is_some_and(|e| e == "csv")) {
        let sound = fs::read(path).expect("it can be read");
        fuzz("csv", Seal::None, vec![sound.clone()], &mut |input| {
            fs::write(path, input).expect("it can be written");
            read(&tables)
        });
        fs::write(path, sound).expect("it can be written");
    }
}

fn store_in(dir: &Path) -> Result<EmbeddedStore, echofix_server::store::Error> {
    let config = ServeArgs::default().config().expect("the defaults hold");
    EmbeddedStore::open(&Options::new(dir.to_owned(), config.mapping.policy()))
}

/// The fixture's map as a file.
fn exported() -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder can be made");
    copy_data(folder.path());
    let store = store_in(folder.path()).expect("the fixture opens");
    let all = i32::MIN..=i32::MAX;
    let tiles = || -> Option<Vec<_>> {
        let zone = *store.zones().first()?;
        let infos = store.catalog(zone, all.clone(), all.clone()).ok()?;
        let whole = {
            let now = *store.progress().borrow();
            now.epoch == now.journaled
        };
        whole.then(|| infos.iter().map(|info| info.id).collect())
    };
    let tiles = until_blocking("the fixture is folded", Duration::from_mins(1), tiles);
    let mut file = Vec::new();
    let region = Region { bounds_deg: [-180.0, -90.0, 180.0, 90.0], tiles };
    store.export(&region, &mut file).expect("it is written");
    file
}

fn copy_data(to: &Path) {
    fs::create_dir(to.join("journal")).expect("a folder can be made");
    for part in [JOURNAL, "manifest", "key"] {
        fs::copy(fixture("data").join(part), to.join(part)).expect("it can be copied");
    }
}

/// Catches: a region that panics, takes much memory, or is called the service's fault.
#[test]
fn region() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let store = store_in(folder.path()).expect("a new store opens");
    fuzz("region", Seal::None, vec![exported()], &mut |input| match store.import(&mut Cursor::new(input)) {
        Ok(_) | Err(echofix_server::store::Error::Unusable(_)) => Ok(()),
        Err(other) => Err(format!("not called unusable: {other}")),
    });
}

/// Catches: a data directory whose files panic: the journal, the manifest.
#[test]
fn data_directory() {
    for (name, file, seal) in [("journal", JOURNAL, Seal::Journal), ("manifest", "manifest", Seal::None)] {
        let sound = fs::read(fixture("data").join(file)).expect("the fixture is there");
        fuzz(name, seal, vec![sound], &mut |input| {
            let folder = tempfile::tempdir().expect("a folder can be made");
            copy_data(folder.path());
            fs::write(folder.path().join(file), input).expect("it can be written");
            // What is folded meanwhile is folded on a thread of its own, which `hang` tells the end of.
            match store_in(folder.path()) {
                Ok(store) => store.hang().map_or(Ok(()), Err),
                Err(_) => Ok(()),
            }
        });
    }
}

/// Catches: requests that panic, or that are answered as the service's fault.
#[test]
fn requests() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let store: Arc<dyn MapStore> = Arc::new(store_in(folder.path()).expect("a new store opens"));
    let config = ServeArgs::default().config().expect("the defaults hold");
    let locator = Arc::new(Locator::new(store, config.locating));
    let api = LocalizationApi::new(Arc::clone(&locator), Arc::default(), Arc::default());
    let asked = asking::requests(&drive(), 5.0, town::seed());
    let sound = asked.iter().take(2).map(|asked| asked.request.encode_to_vec()).collect();
    let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime can be made");
    fuzz("localize", Seal::None, sound, &mut |input| {
        let Ok(request) = LocalizeRequest::decode(input) else { return Ok(()) };
        let admitted = runtime.block_on(locator.admit()).map_err(|refusal| refusal.to_string())?;
        match api.work(request, admitted) {
            Err(status) if matches!(status.code(), Code::Internal | Code::Unknown) => Err(status.to_string()),
            _ => Ok(()),
        }
    });
    let parts = mapping::scan_uploads(&drive()).remove(0).into_parts();
    let sound = parts.iter().map(Message::encode_to_vec).collect();
    fuzz("upload", Seal::None, sound, &mut |input| {
        let _ = UploadRequest::decode(input);
        Ok(())
    });
}
