//! However an upload is sent, it counts once: held against a model.
//!
//! `ECHOFIX_STEPS=1000` makes the long run of it.

use std::collections::BTreeMap;
use std::time::Duration;

use echofix_core::evidence::{CellHits, EvidenceDelta, TileEvidence, VIEW_BLOCKS};
use echofix_core::geo::{TileId, Zone};
use echofix_core::tile;
use echofix_core::time::DAY_US;
use echofix_proto::v1::{UploadRequest, UploadResponse};
use echofix_tests::mapping::{folded, send};
use echofix_tests::service::Service;
use echofix_tests::{crowd, grpc, http, tiles, town};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::task::JoinSet;
use uuid::Uuid;

/// View blocks along a tile's side, and cells along a block's.
const BLOCKS: u32 = 32;
const SIDE: u32 = 16;
/// 2026-01-01.
const FIRST_US: i64 = 20_454 * DAY_US;

fn steps() -> u32 {
    std::env::var("ECHOFIX_STEPS").map_or(40, |text| text.parse().expect("ECHOFIX_STEPS is a number"))
}

/// A tile and a view block in it that only the upload of this number hits: what others see does not make it fade.
fn home(number: u32) -> (TileId, u32) {
    let zone = Zone::from_epsg(32614).expect("a zone of UTM");
    let tile = TileId { zone, y: 65_000, x: 12_000 + (number / VIEW_BLOCKS as u32) as i32 };
    (tile, number % VIEW_BLOCKS as u32)
}

/// Hits of this upload.
fn detections(number: u32) -> u64 {
    u64::from(1 + number % 13) * 10
}

fn parts(seed: u64, number: u32, hits: u32) -> Vec<UploadRequest> {
    let (tile, block) = home(number);
    let first = block / BLOCKS * SIDE * BLOCKS * SIDE + block % BLOCKS * SIDE;
    let hit = |row| CellHits { index: first + row * BLOCKS * SIDE, hits, offset_sum: [hits * 9; 2] };
    let evidence = TileEvidence::of_hits((0..10).map(hit).collect());
    let detections = evidence.detections();
    let contribution = EvidenceDelta { tiles: [(tile, evidence)].into(), detections };
    let (contributor, day) = (format!("car-{}", number % 7), i64::from(number % 3));
    let id = Uuid::from_u64_pair(seed, u64::from(number));
    crowd::upload(id, &contributor, FIRST_US + day * DAY_US, &contribution)
}

/// What must be.
#[derive(Default)]
struct Model {
    /// First answers.
    counted: BTreeMap<u32, UploadResponse>,
    /// Sent, but nobody knows whether they arrived.
    open: Vec<u32>,
    sent: u32,
}

impl Model {
    /// One answer: the first says that it counts, if nobody can have sent it before, and all others repeat it.
    fn record(&mut self, number: u32, answer: UploadResponse, maybe_known: bool) {
        assert_eq!(answer.detections_counted, detections(number), "upload {number}: {answer:?}");
        let Some(first) = self.counted.get(&number) else {
            assert!(maybe_known || !answer.duplicate, "upload {number} is new: {answer:?}");
            self.counted.insert(number, UploadResponse { duplicate: true, ..answer });
            return;
        };
        assert_eq!(&answer, first, "upload {number} was counted before");
    }
}

struct Run {
    seed: u64,
    rng: ChaCha8Rng,
    service: Service,
    model: Model,
}

impl Run {
    fn parts(&self, number: u32) -> Vec<UploadRequest> {
        parts(self.seed, number, 1 + number % 13)
    }

    /// The upload that is sent next: a new one, one whose ack was lost, or one that was counted.
    fn any(&mut self) -> u32 {
        match self.rng.random_range(0..4) {
            0 if !self.model.open.is_empty() => self.model.open.swap_remove(0),
            1 if self.model.sent > 0 => self.rng.random_range(0..self.model.sent),
            _ => {
                self.model.sent += 1;
                self.model.sent - 1
            }
        }
    }

    /// An upload 1 to 10 times at once.
    async fn at_once(&mut self) {
        let before = self.model.sent;
        let number = self.any();
        let maybe_known = number < before;
        let mut calls = JoinSet::new();
        for _ in 0..self.rng.random_range(1..=10) {
            let (mut client, parts) = (grpc::mapping(&self.service).await, self.parts(number));
            calls.spawn(async move { send(&mut client, &parts).await });
        }
        let mut answers: Vec<_> =
            calls.join_all().await.into_iter().map(|a| a.expect("it is answered")).collect();
        let firsts = answers.iter().filter(|answer| !answer.duplicate).count();
        assert!(firsts == 1 || firsts == 0 && maybe_known, "{firsts} of {} count", answers.len());
        answers.sort_by_key(|answer| answer.duplicate);
        for answer in answers {
            self.model.record(number, answer, maybe_known);
        }
        self.model.open.retain(|open| *open != number);
    }

    /// Uploads whose callers go away at any moment.
    async fn without_ack(&mut self) {
        for _ in 0..self.rng.random_range(1..5) {
            let number = self.any();
            let (mut client, parts) = (grpc::mapping(&self.service).await, self.parts(number));
            let patience = Duration::from_micros(self.rng.random_range(0..6_000));
            match tokio::time::timeout(patience, send(&mut client, &parts)).await {
                Ok(answer) => self.model.record(number, answer.expect("it is answered"), true),
                Err(_) => self.model.open.push(number),
            }
        }
    }

    /// An id under which something else is sent: it is that upload's, whatever comes.
    async fn other_content(&mut self) {
        let Some(number) = self.model.counted.keys().next_back().copied() else { return };
        let mut client = grpc::mapping(&self.service).await;
        let answer = send(&mut client, &parts(self.seed, number, 100)).await.expect("it is answered");
        self.model.record(number, answer, true);
    }

    /// The end of the process, on request or by kill -9, while uploads are under way.
    async fn restart(&mut self, gently: bool) {
        let mut calls = JoinSet::new();
        for _ in 0..self.rng.random_range(0..6) {
            let number = self.any();
            let (mut client, parts) = (grpc::mapping(&self.service).await, self.parts(number));
            calls.spawn(async move { (number, send(&mut client, &parts).await) });
        }
        tokio::time::sleep(Duration::from_micros(self.rng.random_range(0..8_000))).await;
        if gently {
            self.service.ask_to_end();
            let service = &mut self.service;
            tokio::task::block_in_place(|| service.ended());
        } else {
            self.service.kill();
        }
        let mut answers = Vec::new();
        for (number, answer) in calls.join_all().await {
            match answer {
                Ok(answer) => answers.push((number, answer)),
                Err(_) => self.model.open.push(number),
            }
        }
        // Of one upload that was sent twice at once, the first answer may arrive last.
        answers.sort_by_key(|(_, answer)| answer.duplicate);
        for (number, answer) in answers {
            self.model.record(number, answer, true);
        }
        tokio::task::block_in_place(|| self.service.start_again());
    }

    async fn step(&mut self) {
        match self.rng.random_range(0..10) {
            0 => self.restart(true).await,
            1 => self.restart(false).await,
            2 => self.other_content().await,
            3..6 => self.without_ack().await,
            _ => self.at_once().await,
        }
    }

    /// Sends again whatever nobody knows of; then the map is what the model says.
    async fn judge(mut self) {
        let mut client = grpc::mapping(&self.service).await;
        for number in 0..self.model.sent {
            let answer = send(&mut client, &self.parts(number)).await.expect("it is answered");
            self.model.record(number, answer, true);
        }
        let epoch = folded(&self.service).await;
        assert_eq!(epoch, u64::from(self.model.sent), "a record for each upload");
        let map = http::get(&format!("{}/api/v1/map", self.service.http)).json();
        assert_eq!(map["totals"]["uploads"], self.model.sent, "{map}");
        let served = tiles::all(&self.service).await;
        let mut found: BTreeMap<(TileId, u32), u64> = BTreeMap::new();
        for (id, (_, encoded)) in &served {
            for (index, cell) in tile::decode(encoded).expect("a tile decodes").cells() {
                let block = index / (BLOCKS * SIDE) / SIDE * BLOCKS + index % (BLOCKS * SIDE) / SIDE;
                *found.entry((*id, block)).or_default() += u64::from(cell.hits);
            }
        }
        let expected: BTreeMap<_, _> =
            (0..self.model.sent).map(|number| (home(number), detections(number))).collect();
        assert_eq!(found, expected);
        eprintln!("{} steps, {} uploads, each counted once", steps(), self.model.sent);
    }
}

/// Catches: an id that is looked up and claimed in two steps, one that is forgotten at a restart, one noted before
/// it is on disk, and a fold that is done twice.
#[tokio::test(flavor = "multi_thread")]
async fn an_upload_counts_once_however_it_is_sent() {
    let seed = town::seed();
    let rng = ChaCha8Rng::seed_from_u64(seed);
    let mut run = Run { seed, rng, service: Service::start(), model: Model::default() };
    for _ in 0..steps() {
        run.step().await;
    }
    run.judge().await;
}
