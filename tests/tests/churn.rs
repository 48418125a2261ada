//! Many uploads to few tiles: what is on disk stays in proportion to what is live, and nothing leaks.
//!
//! The numbers are printed. The long run of it takes 500 tiles:
//!
//! ```text
//! ECHOFIX_CHURN=20000 cargo test -p echofix-tests --test churn -- --nocapture
//! ```

use std::fs;
use std::ops::Range;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, Instant};

use echofix_core::evidence::{CellHits, EvidenceDelta, TileEvidence};
use echofix_core::geo::{TileId, Zone};
use echofix_core::time::DAY_US;
use echofix_proto::v1::UploadRequest;
use echofix_tests::mapping::{folded, send};
use echofix_tests::service::Service;
use echofix_tests::{command, crowd, grpc, http, town, until};
use rand::seq::index::sample;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::task::JoinSet;
use uuid::Uuid;

/// Uploads to a tile.
const EACH: u32 = 40;
/// Cells of a tile.
const CELLS: usize = 512 * 512;
/// Cells of a tile where something stands.
const THINGS: usize = 20_000;
/// Uploads at once.
const VEHICLES: u32 = 8;
/// Contributors; each comes once a day.
const CONTRIBUTORS: u32 = 50;
const FIRST_US: i64 = 20_454 * DAY_US;
/// What sled may take beyond, however little it holds, bytes.
const FLOOR: u64 = 16 << 20;
const SAMPLES: u32 = 10;
/// Uploads that tell nothing new, in so many steps.
const KNOWN: u32 = 2000;
const KNOWN_STEPS: u32 = 6;
/// What an upload may leave in memory besides its part of the map, bytes.
const LEFT: u64 = 100;
/// What may come and go besides, bytes: where the map stays as it is, and where it grows.
const NOISE: u64 = 2 << 20;
const BURSTS: u64 = 8 << 20;

fn uploads() -> u32 {
    std::env::var("ECHOFIX_CHURN").map_or(800, |text| text.parse().expect("ECHOFIX_CHURN is a number"))
}

/// Some of the things in one of the tiles, and some clutter.
fn parts(seed: u64, number: u32) -> Vec<UploadRequest> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ u64::from(number) << 20);
    let x = rng.random_range(0..(uploads() / EACH).max(1));
    let mut things = ChaCha8Rng::seed_from_u64(seed ^ u64::from(x));
    let things = sample(&mut things, CELLS, THINGS).into_vec();
    let seen = sample(&mut rng, THINGS, 250).into_iter().map(|at| things[at]).collect::<Vec<_>>();
    let clutter = sample(&mut rng, CELLS, 20).into_vec();
    let mut indices: Vec<_> = seen.into_iter().chain(clutter).map(|index| index as u32).collect();
    indices.sort_unstable();
    indices.dedup();
    let mut hit =
        |index| CellHits { index, hits: 2, offset_sum: [0; 2].map(|_: u32| rng.random_range(0..512)) };
    let evidence = TileEvidence::of_hits(indices.into_iter().map(&mut hit).collect());
    upload(seed, number, x, i64::from(number / CONTRIBUTORS) % 60, evidence)
}

/// What the map knows already: the same cells of a tile, from the same contributor on the same day.
fn known_parts(seed: u64, number: u32) -> Vec<UploadRequest> {
    let hit = |index: u32| CellHits { index: index * 300, hits: 1, offset_sum: [128; 2] };
    upload(seed, number, number % 5, 0, TileEvidence::of_hits((0..20).map(hit).collect()))
}

fn upload(seed: u64, number: u32, x: u32, day: i64, evidence: TileEvidence) -> Vec<UploadRequest> {
    let tile =
        TileId { zone: Zone::from_epsg(32614).expect("a zone of UTM"), y: 65_000, x: 12_000 + x as i32 };
    let detections = evidence.detections();
    let contribution = EvidenceDelta { tiles: [(tile, evidence)].into(), detections };
    let contributor = format!("car-{}", number % CONTRIBUTORS);
    let id = Uuid::from_u64_pair(seed, number.into());
    crowd::upload(id, &contributor, FIRST_US + day * DAY_US, &contribution)
}

/// Vehicles send the uploads of these numbers, several at once.
async fn send_all(
    service: &Service,
    numbers: Range<u32>,
    parts: impl Fn(u32) -> Vec<UploadRequest> + Copy + Send + 'static,
) {
    let mut vehicles = JoinSet::new();
    for vehicle in 0..VEHICLES {
        let mut client = grpc::mapping(service).await;
        let numbers = numbers.clone();
        vehicles.spawn(async move {
            for number in numbers.filter(|number| number % VEHICLES == vehicle) {
                send(&mut client, &parts(number)).await.expect("it counts");
            }
        });
    }
    vehicles.join_all().await;
}

/// Bytes of a file, or of all files below a folder, as the disk holds them.
fn disk_use(path: &Path) -> u64 {
    let Ok(about) = fs::symlink_metadata(path) else { return 0 };
    if !about.is_dir() {
        return about.blocks() * 512;
    }
    // Files come and go meanwhile.
    fs::read_dir(path).into_iter().flatten().flatten().map(|entry| disk_use(&entry.path())).sum()
}

/// What a service takes.
#[derive(Debug, Clone, Copy)]
struct MemorySample {
    at: Instant,
    uploads: u32,
    /// Bytes of the journal, of the tiles and bases on disk, and of the encoded tiles.
    journal: u64,
    tiles: u64,
    live: u64,
    descriptors: usize,
    /// Bytes of memory, but for the program's own.
    memory: u64,
}

impl MemorySample {
    async fn of(service: &Service, uploads: u32) -> Self {
        folded(service).await;
        let journal = disk_use(&service.data_dir().join("journal"));
        let tiles = disk_use(&service.data_dir()) - journal;
        let map = http::get(&format!("{}/api/v1/map", service.http)).json();
        let live = map["totals"]["bytes"].as_u64().expect("a number");
        let process = Path::new("/proc").join(service.pid().to_string());
        let descriptors = fs::read_dir(process.join("fd")).expect("it runs").count();
        let status = fs::read_to_string(process.join("status")).expect("it runs");
        let memory = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).expect("Linux tells it");
        let memory: u64 = memory.trim().trim_end_matches(" kB").parse().expect("kilobytes");
        eprintln!(
            "{uploads} uploads: journal {} kB, tiles on disk {} kB for {} kB encoded ({:.2}), {descriptors} \
             descriptors, {:.1} MB of memory",
            journal >> 10,
            tiles >> 10,
            live >> 10,
            tiles as f64 / live as f64,
            memory as f64 / 1024.0,
        );
        Self { at: Instant::now(), uploads, journal, tiles, live, descriptors, memory: memory << 10 }
    }
}

/// Live are the tiles as they are encoded and the contributions of the retention window, which are the journal.
///
/// Catches: old values of the tile store that nobody removes (values in sled that are not cut, or its mode for
/// throughput, in the long form), settled segments that stay, files that stay open.
#[tokio::test(flavor = "multi_thread")]
async fn what_a_service_takes_follows_the_map_and_not_the_uploads() {
    let seed = town::seed();
    let service = Service::start_with(&["mapping.vet=false"]);
    let mut samples = Vec::new();
    for step in 0..SAMPLES {
        let (from, to) = (step * uploads() / SAMPLES, (step + 1) * uploads() / SAMPLES);
        send_all(&service, from..to, move |number| parts(seed, number)).await;
        samples.push(MemorySample::of(&service, to).await);
    }
    let (half, end) = (samples[samples.len() / 2 - 1], samples[samples.len() - 1]);
    let grown = (end.memory as f64 - half.memory as f64) / f64::from(1 << 20);
    let minutes = (end.at - half.at).as_secs_f64() / 60.0;
    eprintln!(
        "second half: {} uploads in {minutes:.2} minutes, {grown:.1} MB more memory, {:.2} MB a minute",
        end.uploads - half.uploads,
        grown / minutes,
    );
    let compact =
        ["map", "compact", "--yes", "--before", &command::tomorrow(), "--http", &service.http, "--json"];
    assert!(command::echofix(compact).json()["epoch"].is_u64());
    folded(&service).await;
    until("the old tiles are gone", Duration::from_secs(30), async || {
        let names =
            fs::read_dir(service.data_dir()).expect("it is there").flatten().map(|entry| entry.file_name());
        (names.filter(|name| name.to_string_lossy().starts_with("tiles-")).count() == 1).then_some(())
    })
    .await;
    let compacted = MemorySample::of(&service, uploads()).await;
    for MemorySample { uploads, tiles, live, .. } in &samples {
        assert!(*tiles <= 3 * live + FLOOR, "{uploads} uploads: {tiles} bytes on disk for {live} of tiles");
    }
    assert!(end.descriptors <= half.descriptors + 4, "{half:?} {end:?}");
    // sled holds what is live in memory too, ledgers and pages half empty included.
    let allowed = 2 * (end.live - half.live) + u64::from(end.uploads - half.uploads) * LEFT + BURSTS;
    assert!(end.memory <= half.memory + allowed, "{half:?} {end:?}");
    // The base beside the tiles is another copy of them.
    assert!(compacted.tiles <= 4 * compacted.live + FLOOR, "{compacted:?}");
    assert!(compacted.journal < 64 << 10, "{compacted:?}");
}

/// The map does not grow, so what grows is what an upload leaves behind: its entry in the journal's index.
///
/// Catches: anything else that stays in memory for every upload.
#[tokio::test(flavor = "multi_thread")]
async fn an_upload_leaves_little_in_memory() {
    let seed = town::seed();
    let service = Service::start_with(&["mapping.vet=false"]);
    let mut samples = Vec::new();
    for step in 0..KNOWN_STEPS {
        send_all(&service, step * KNOWN..(step + 1) * KNOWN, move |number| known_parts(seed, number)).await;
        samples.push(MemorySample::of(&service, (step + 1) * KNOWN).await);
    }
    let (half, end) = (samples[samples.len() / 2 - 1], samples[samples.len() - 1]);
    assert!(end.live < half.live + (4 << 10), "the map grew: {half:?} {end:?}");
    let allowed = u64::from(end.uploads - half.uploads) * LEFT + NOISE;
    assert!(end.memory <= half.memory + allowed, "{half:?} {end:?}");
}
