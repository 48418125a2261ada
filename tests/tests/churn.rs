//! Many uploads to few tiles: what is on disk stays in proportion to what is live, and nothing leaks.
//!
//! `ECHOFIX_CHURN=20000` makes the long run of it; the numbers are printed.

use std::fs;
use std::path::Path;

use echofix_core::evidence::{CellHits, Contribution, Share};
use echofix_core::geo::{TileId, Zone};
use echofix_proto::v1::UploadRequest;
use echofix_tests::mapping::{send, settled};
use echofix_tests::service::Service;
use echofix_tests::{command, crowd, grpc, http, town};
use rand::seq::index::sample;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::task::JoinSet;
use uuid::Uuid;

const TILES: i32 = 4;
/// Cells of a tile.
const CELLS: usize = 512 * 512;
/// Places of a tile where something stands.
const THINGS: usize = 20_000;
/// Uploads at once.
const VEHICLES: u32 = 8;
/// Contributors; each comes once a day.
const CONTRIBUTORS: u32 = 50;
const DAY_US: i64 = 86_400_000_000;
const FIRST_US: i64 = 20_454 * DAY_US;

fn uploads() -> u32 {
    std::env::var("ECHOFIX_CHURN").map_or(400, |text| text.parse().expect("ECHOFIX_CHURN is a number"))
}

/// Some of the things in one of the tiles, and some clutter.
fn parts(seed: u64, number: u32) -> Vec<UploadRequest> {
    let mut things = ChaCha8Rng::seed_from_u64(seed);
    let things = sample(&mut things, CELLS, THINGS).into_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ u64::from(number) << 20);
    // Fewer in each place than vetting would take for evidence of where the vehicle was.
    let seen = sample(&mut rng, THINGS, 250).into_iter().map(|at| things[at]).collect::<Vec<_>>();
    let clutter = sample(&mut rng, CELLS, 20).into_vec();
    let mut indices: Vec<_> = seen.into_iter().chain(clutter).map(|index| index as u32).collect();
    indices.sort_unstable();
    indices.dedup();
    let hit = |index| CellHits { index, hits: 2, offset_sum: [100, 300] };
    let share = Share::of_hits(indices.into_iter().map(hit).collect());
    let x = 12_000 + rng.random_range(0..TILES);
    let tile = TileId { zone: Zone::from_epsg(32614).expect("a zone of UTM"), y: 65_000, x };
    let detections = share.detections();
    let contribution = Contribution { tiles: [(tile, share)].into(), detections };
    let day = i64::from(number / CONTRIBUTORS);
    let contributor = format!("car-{}", number % CONTRIBUTORS);
    crowd::upload(
        Uuid::from_u64_pair(seed, u64::from(number)),
        &contributor,
        FIRST_US + day % 60 * DAY_US,
        &contribution,
    )
}

/// Bytes of a file, or of all files below a folder, as the disk holds them.
fn disk_use(path: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt;
    let Ok(about) = fs::symlink_metadata(path) else { return 0 };
    if !about.is_dir() {
        return about.blocks() * 512;
    }
    // Files come and go meanwhile.
    fs::read_dir(path).into_iter().flatten().flatten().map(|entry| disk_use(&entry.path())).sum()
}

/// What a service takes.
#[derive(Debug, Clone, Copy)]
struct Sample {
    uploads: u32,
    /// Bytes of the journal, of the tiles and bases on disk, and of the encoded tiles.
    journal: u64,
    tiles: u64,
    live: u64,
    descriptors: usize,
    memory: u64,
}

impl Sample {
    async fn of(service: &Service, uploads: u32) -> Self {
        settled(service).await;
        let journal = disk_use(&service.data_dir().join("journal"));
        let tiles = disk_use(&service.data_dir()) - journal;
        let map = http::get(&format!("{}/api/v1/map", service.http)).json();
        let live = map["totals"]["bytes"].as_u64().expect("a number");
        let process = Path::new("/proc").join(service.pid().to_string());
        let descriptors = fs::read_dir(process.join("fd")).expect("it runs").count();
        let status = fs::read_to_string(process.join("status")).expect("it runs");
        let memory = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("Linux tells it");
        let memory: u64 = memory.trim().trim_end_matches(" kB").parse().expect("kilobytes");
        let sample = Self { uploads, journal, tiles, live, descriptors, memory: memory << 10 };
        eprintln!(
            "{uploads} uploads: journal {} kB, tiles on disk {} kB for {} kB encoded ({:.2}), {descriptors} descriptors, {} MB",
            journal >> 10,
            tiles >> 10,
            live >> 10,
            tiles as f64 / live as f64,
            memory >> 10,
        );
        sample
    }
}

/// Catches: blobs and old values of the tile store that nobody removes, files that stay open, and uploads that
/// stay in memory.
#[tokio::test(flavor = "multi_thread")]
async fn disk_descriptors_and_memory_follow_the_map_not_the_uploads() {
    let seed = town::seed();
    let service = Service::start_with(&["store.cache_mib=16", "mapping.vet=false"]);
    let steps = 10;
    let mut samples = Vec::new();
    for step in 0..steps {
        let (from, to) = (step * uploads() / steps, (step + 1) * uploads() / steps);
        let mut vehicles = JoinSet::new();
        for vehicle in 0..VEHICLES {
            let mut client = grpc::mapping(&service).await;
            vehicles.spawn(async move {
                for number in (from..to).filter(|number| number % VEHICLES == vehicle) {
                    send(&mut client, &parts(seed, number)).await.expect("it counts");
                }
            });
        }
        vehicles.join_all().await;
        samples.push(Sample::of(&service, to).await);
    }
    for Sample { uploads, journal, tiles, live, .. } in &samples {
        let all = (journal + tiles) as f64 / (journal + live) as f64;
        assert!(all <= 3.0, "{uploads} uploads: {all:.2} times what is live is on disk");
    }
    let (half, end) = (samples[samples.len() / 2], samples[samples.len() - 1]);
    assert!(end.descriptors <= half.descriptors + 4, "{half:?} {end:?}");
    let each = end.memory.saturating_sub(half.memory) / u64::from(end.uploads - half.uploads);
    eprintln!("{each} bytes of memory an upload in the second half");
    let settled_map =
        command::echofix(["map", "compact", "--before", "2149-01-01", "--http", &service.http, "--json"]);
    assert!(settled_map.json()["epoch"].is_u64());
    let last = Sample::of(&service, uploads()).await;
    eprintln!("after the settlement: {:.2}", last.tiles as f64 / last.live as f64);
}
