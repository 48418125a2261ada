//! A fix allocates nothing once its buffers are warm: search, refinement and verdict.

#![expect(unsafe_code, reason = "an allocator that counts is an allocator")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell as Counter;
use std::collections::BTreeMap;
use std::sync::Arc;

use echofix_core::align::verdict::{Integrity, Verdict};
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Aligner, Alignment, EngineKind, Prior, Search, Task};
use echofix_core::batch::{Batch, Sighting};
use echofix_core::evidence::{Cell, presence};
use echofix_core::geo::{CellIndex, TileId, Zone};
use echofix_core::point::{BodyPoint, MapPoint};
use echofix_core::pose::Pose2;
use echofix_core::tile::Tile;
use echofix_core::window::MapSquare;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

thread_local! {
    /// Allocations of this thread: tests run side by side.
    static ALLOCATIONS: Counter<u64> = const { Counter::new(0) };
}

/// The system's allocator, counted.
struct Counting;

fn count() {
    ALLOCATIONS.with(|all| all.set(all.get() + 1));
}

// SAFETY: everything is the system's; counting in a constant thread-local without a destructor
// neither allocates nor fails.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller's promise.
        unsafe { System.realloc(block, layout, size) }
    }
}

/// A body among walls and posts, and what it saw of them in 5 s.
struct WarmScene {
    square: MapSquare,
    tiles: Vec<Arc<TileWeights>>,
    batch: Batch,
    prior: Prior,
}

impl WarmScene {
    fn new(seed: u64, sigma_position_m: f64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let zone = Zone::from_epsg(32614).expect("a zone of UTM");
        let truth = Pose2::new(
            600_000.0 + rng.random_range(0.0..200.0),
            3_300_000.0 + rng.random_range(0.0..200.0),
            rng.random_range(-3.0..3.0),
        );
        let structure = structure(&mut rng);
        let off = [0, 1].map(|_| rng.random_range(-0.7..0.7));
        let pose = Pose2::new(truth.x_m + off[0], truth.y_m + off[1], truth.yaw_rad + 0.02);
        let sigma_yaw_rad = 3_f64.to_radians();
        let prior = Prior { pose, sigma_position_m, sigma_yaw_rad, scale: 1.0 };
        let square = MapSquare::around(zone, MapPoint::of(&pose), 50.0, 3.0 * sigma_position_m);
        let on_map: Vec<_> = structure.iter().map(|p| truth.transform(*p).into()).collect();
        Self { square, tiles: weights(&square, &on_map), batch: batch(&structure, &mut rng), prior }
    }

    fn align(&self, aligner: &mut Aligner, kind: EngineKind) -> Alignment {
        let Self { square, tiles, batch, prior } = self;
        let task = Task { square: *square, tiles, batch, prior };
        aligner.align(&task, kind.engine(), &Search::default(), &Integrity::default())
    }
}

/// Points in the body's frame, metres.
fn structure(rng: &mut ChaCha8Rng) -> Vec<[f64; 2]> {
    let mut points = Vec::new();
    for offset in [-12.0, 9.0] {
        points.extend((0..500).map(|i| [-45.0 + 0.18 * f64::from(i), offset]));
    }
    points.extend((0..600).map(|_| [rng.random_range(-35.0..35.0), rng.random_range(-35.0..35.0)]));
    points.retain(|[x, y]| x.hypot(*y) < 49.0);
    points
}

/// Fifty scans, each of a part of the structure.
fn batch(structure: &[[f64; 2]], rng: &mut ChaCha8Rng) -> Batch {
    let mut batch = Batch { speed_mps: 10.0, duration_s: 4.9, ..Batch::default() };
    for scan in 0..50_u32 {
        let age_s = 0.1 * f64::from(49 - scan);
        let body = Pose2::new(-10.0 * age_s, 0.0, 0.0);
        batch.sightings.push(Sighting { first: batch.points.len(), age_s, body, sensor: 0 });
        for _ in 0..80 {
            let [x, y] = structure[rng.random_range(0..structure.len())];
            let [x_m, y_m] = [x, y].map(|v| (v + rng.random_range(-0.1..0.1)) as f32);
            batch.points.push(BodyPoint { x_m, y_m });
        }
    }
    batch.detections = batch.points.len() as u64;
    batch
}

fn weights(square: &MapSquare, points: &[MapPoint]) -> Vec<Arc<TileWeights>> {
    let mut cells: BTreeMap<TileId, BTreeMap<u32, Cell>> = BTreeMap::new();
    for point in points {
        let (id, index) = TileId::locate(square.zone, CellIndex::of(*point));
        let middle = Cell {
            hits: 2,
            passes: 1,
            contributors: 1,
            presence: presence::ALWAYS,
            offset_sum: [256, 256],
            ..Cell::default()
        };
        cells.entry(id).or_default().insert(index, middle);
    }
    let tile = |cells: BTreeMap<u32, Cell>| Tile::from_cells(cells.into_iter().collect());
    let tiles: BTreeMap<TileId, Tile> =
        cells.into_iter().map(|(id, cells)| (id, tile(cells).expect("cells are in order"))).collect();
    let known = square.tiles().filter(|id| tiles.contains_key(id));
    known.map(|id| Arc::new(TileWeights::new(id, |at| tiles.get(&at)))).collect()
}

/// The largest number of allocations of a fix, after every scene was asked about once. Scenes lie at
/// several positions and are asked about in turns, so that views and bounds are made anew each time.
fn allocations(kind: EngineKind, scenes: &[WarmScene]) -> u64 {
    let mut aligner = Aligner::default();
    for scene in scenes {
        let alignment = scene.align(&mut aligner, kind);
        assert_eq!(alignment.verdict, Verdict::Usable, "{alignment:?}");
    }
    let asked = scenes.iter().chain(scenes).chain(&scenes[..1]).chain(&scenes[..1]);
    let cost = asked.map(|scene| {
        let before = ALLOCATIONS.get();
        std::hint::black_box(scene.align(&mut aligner, kind));
        ALLOCATIONS.get() - before
    });
    cost.max().expect("there are scenes")
}

/// Catches a buffer that is made anew for every fix: breaks with one `to_vec` anywhere on the way.
#[test]
fn a_warm_fix_allocates_nothing() {
    let usual: Vec<_> = (0..3).map(|seed| WarmScene::new(seed, 2.0)).collect();
    assert_eq!(allocations(EngineKind::Fast, &usual), 0, "fast");
    assert_eq!(allocations(EngineKind::Bounded, &usual), 0, "bounded");
    // Wider, where a coarser image is searched first; and narrow and wide in turns.
    let mixed = [WarmScene::new(3, 4.0), WarmScene::new(4, 0.5), WarmScene::new(5, 4.0)];
    assert_eq!(allocations(EngineKind::Fast, &mixed), 0, "fast, wide and narrow");
    assert_eq!(allocations(EngineKind::Bounded, &mixed), 0, "bounded, wide and narrow");
}
