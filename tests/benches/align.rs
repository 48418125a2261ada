//! What an alignment costs, step by step: `cargo bench -p echofix-tests`.
//!
//! One thread; compare ratios within one run.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use divan::{Bencher, black_box};
use echofix_core::align::fft::{FftWorkspace, Plans};
use echofix_core::align::verdict::Integrity;
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Aligner, EngineKind, Prior, Search, Task};
use echofix_core::batch::Batch;
use echofix_core::drive::GeoPose;
use echofix_core::evidence::{EvidenceAccumulator, Pass};
use echofix_core::gate::Gate;
use echofix_core::geo::{Grid, TileId};
use echofix_core::odometry::Trajectory;
use echofix_core::point::MapPoint;
use echofix_core::tile::{Ledger, Tile};
use echofix_core::window::MapSquare;
use echofix_sim::{City, CityParams, DriveParams, Route, simulate};

#[global_allocator]
static ALLOCATOR: divan::AllocProfiler = divan::AllocProfiler::system();

fn main() {
    divan::main();
}

/// A mapped stretch of the town and a 5 s batch on it, three days later.
struct BenchScene {
    tiles: BTreeMap<TileId, Tile>,
    square: MapSquare,
    batch: Batch,
    prior: Prior,
}

static SCENE: LazyLock<BenchScene> = LazyLock::new(BenchScene::new);

impl BenchScene {
    fn new() -> Self {
        let city = City::generate(&CityParams::default()).expect("the default town can be made");
        let grid = Grid::of(city.site().origin()).expect("the default town lies inside UTM");
        let (scale, gate) = (city.site().scale(), Gate::default());
        let way = Route::wander(&city, 1, 400.0);
        let drive = |day: u32, seed: u64| {
            let params = DriveParams { seed, ..DriveParams::default() };
            simulate(&city.on_day(day), &way, &params).expect("the default drive can be made")
        };
        let mut tiles: BTreeMap<TileId, (Tile, Ledger)> = BTreeMap::new();
        for contributor in 0..5 {
            let seen = drive(0, contributor);
            let poses = on_grid(&grid, &seen.reference);
            let mut gathering = EvidenceAccumulator::default();
            let (detections, _) = gathering
                .add(grid.zone(), &seen.scans, &seen.mounts, &poses, scale, &gate)
                .expect("every sensor is mounted");
            for (id, evidence) in &gathering.finish(detections).tiles {
                let (tile, ledger) = tiles.entry(*id).or_default();
                tile.fold(ledger, Pass { day: 20_000, contributor }, evidence);
            }
        }
        let lost = drive(3, 99);
        let middle = lost.scans[lost.scans.len() / 2].time_us;
        let scans: Vec<_> = lost
            .scans
            .iter()
            .filter(|s| (middle - 5_000_000..=middle).contains(&s.time_us))
            .cloned()
            .collect();
        let batch = Batch::organise(&scans, &lost.mounts, &lost.odometry, middle, &gate)
            .expect("the odometry covers the drive");
        let mut pose = on_grid(&grid, &lost.truth).at(middle).expect("the truth covers the drive");
        (pose.x_m, pose.y_m, pose.yaw_rad) = (pose.x_m + 1.0, pose.y_m - 1.5, pose.yaw_rad + 0.03);
        let prior = Prior { pose, sigma_position_m: 2.0, sigma_yaw_rad: 3_f64.to_radians(), scale };
        let square = MapSquare::around(grid.zone(), MapPoint::of(&pose), 50.0, 6.0);
        let tiles = tiles.into_iter().map(|(id, (tile, _))| (id, tile)).collect();
        Self { tiles, square, batch, prior }
    }

    fn weights(&self) -> Vec<Arc<TileWeights>> {
        let known = self.square.tiles().filter(|id| self.tiles.contains_key(id));
        known.map(|id| Arc::new(TileWeights::new(id, |at| self.tiles.get(&at)))).collect()
    }

    fn fix(&self, bencher: Bencher, kind: EngineKind) {
        let (tiles, mut aligner) = (self.weights(), Aligner::default());
        let (search, integrity) = (Search::default(), Integrity::default());
        let task = Task { square: self.square, tiles: &tiles, batch: &self.batch, prior: &self.prior };
        bencher.bench_local(|| aligner.align(&task, kind.engine(), &search, &integrity));
    }
}

fn on_grid(grid: &Grid, poses: &[GeoPose]) -> Trajectory {
    let placed = poses
        .iter()
        .map(|p| (p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad).expect("the town lies inside UTM")));
    Trajectory::new(placed).expect("the simulator's poses are in order")
}

/// The whole answer: search, climb, verdict. What it allocates is the answer's own.
#[divan::bench(sample_count = 200)]
fn fix_fast(bencher: Bencher) {
    SCENE.fix(bencher, EngineKind::Fast);
}

/// The same with the exact maximum, by bounds.
#[divan::bench(sample_count = 100)]
fn fix_bounded(bencher: Bencher) {
    SCENE.fix(bencher, EngineKind::Bounded);
}

/// The same by the FFT: 19 headings, 121 x 121 shifts each.
#[divan::bench(sample_count = 20)]
fn fix_fft(bencher: Bencher) {
    SCENE.fix(bencher, EngineKind::Fft);
}

/// What a tile costs when it is not in the cache.
#[divan::bench(sample_count = 50)]
fn tile_prepared(bencher: Bencher) {
    let busiest = SCENE.tiles.iter().max_by_key(|(_, tile)| tile.len()).expect("the map has tiles");
    bencher.bench_local(|| TileWeights::new(*busiest.0, |at| SCENE.tiles.get(&at)));
}

/// One heading's correlation by the side of the window: why windows are 1200 cells wide.
#[divan::bench(args = [1152, 1200, 1250, 1280, 1296, 1440], sample_count = 20)]
fn one_heading(bencher: Bencher, side: usize) {
    const LAG: usize = 60;
    let plans = Plans::new(side);
    let mut workspace = FftWorkspace::default();
    let map: Vec<f32> = (0..side * side).map(|i| ((i * 7919) % 97) as f32 / 97.0).collect();
    let mut batch = vec![0.0; side * side];
    for i in 0..7000 {
        let (x, y) = (LAG + (i * 7919) % (side - 2 * LAG), LAG + (i * 104_729) % (side - 2 * LAG));
        batch[y * side + x] = 0.3;
    }
    let spectrum = plans.spectrum(&map, &mut workspace);
    let mut out = vec![0.0; (2 * LAG + 1).pow(2)];
    bencher.bench_local(|| {
        plans.correlate(&spectrum, black_box(&batch), LAG, &mut workspace, &mut out);
    });
}
