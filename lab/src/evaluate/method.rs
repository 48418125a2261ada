//! The methods that are compared, and the maps as they need them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

pub use echofix_core::align::Prior;
use echofix_core::align::drift::DriftPrior;
use echofix_core::align::fft::Plans;
use echofix_core::align::image::MapImage;
use echofix_core::align::pipeline::Pipeline;
use echofix_core::align::verdict::{Integrity, Protection, Verdict};
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Aligner, CorrelationWorkspace, EngineKind, Search, Task, fast_global_align};
use echofix_core::batch::Batch;
use echofix_core::evidence::InverseSensorModel;
use echofix_core::geo::TileId;
use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;
use echofix_core::window::MapSquare;
use echofix_server::locating::verdict_word;
use moka::policy::EvictionPolicy;
use moka::sync::Cache;

use super::map::{MapKey, Movers, RadarMap};

/// Integrity risk of the protection levels.
pub const RISK: f64 = 1e-3;

/// The answer of a method.
#[derive(Debug, Clone, PartialEq)]
pub struct MethodAnswer {
    /// The pose: map metres, radians from grid east.
    pub pose: Pose2,
    /// Covariance of (east m, north m, yaw rad), if the method gives one.
    pub covariance: Option<[[f64; 3]; 3]>,
    /// Whether it may be used.
    pub usable: bool,
    /// The verdict in a word, which says why it may not be used.
    pub verdict: &'static str,
    /// Protection levels, if the method gives them.
    pub protection: Option<Protection>,
    /// Score of the best alternative relative to the answer's; 0 without an alternative.
    pub second: f64,
    /// Log-likelihood by which the answer exceeds the best alternative, nats, if the method gives it.
    pub margin: Option<f64>,
    /// Time of the fix, without that of preparing its map window.
    pub elapsed: Duration,
}

impl MethodAnswer {
    /// The answer of a method that has no verdict.
    fn unjudged(pose: Pose2) -> Self {
        let (covariance, protection, margin) = (None, None, None);
        let elapsed = Duration::ZERO;
        Self {
            pose,
            covariance,
            usable: true,
            verdict: "NOT_JUDGED",
            protection,
            second: 0.0,
            margin,
            elapsed,
        }
    }
}

/// A way to find the pose of a batch on a map.
pub trait Method: Send {
    /// Its name in tables.
    fn name(&self) -> &'static str;
    /// Whether movers are part of its maps and batches.
    fn movers(&self) -> Movers;
    /// Finds the pose of a batch on a map.
    fn fix(&mut self, map: &RadarMap, batch: &Batch, prior: &Prior) -> MethodAnswer;
}

/// The name of a method on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum MethodName {
    /// The paper's method: the hypothesis of the highest correlation.
    Paper,
    /// The paper's method without movers, and with odometry that radial speeds corrected.
    Gated,
    /// The hypothesis of the highest mean log weight, without movers.
    Weights,
    /// The method of the service.
    Echofix,
    /// The method of the service with the exact search by bounds.
    Exact,
    /// The method of the service without drift: the batch is taken as rigid.
    Rigid,
    /// The method of the service without radial speeds: movers are included, and the odometry is not corrected.
    NoDoppler,
}

impl MethodName {
    /// The methods of the ablation, from the paper's on.
    pub const LADDER: [Self; 7] =
        [Self::Paper, Self::Gated, Self::Weights, Self::Rigid, Self::Echofix, Self::NoDoppler, Self::Exact];

    /// Its name in tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Gated => "paper, without movers",
            Self::Weights => "log weights, highest hypothesis",
            Self::Rigid => "log weights, refined, rigid batch",
            Self::Echofix => "echofix",
            Self::NoDoppler => "echofix without radial speeds",
            Self::Exact => "echofix, exact search",
        }
    }

    /// The method, for one thread. All threads use the same `windows`.
    pub fn method(self, windows: &Arc<Windows>) -> Box<dyn Method> {
        let windows = Arc::clone(windows);
        match self {
            Self::Paper => Box::new(Paper::new(self, windows, Movers::Included)),
            Self::Gated => Box::new(Paper::new(self, windows, Movers::Excluded)),
            Self::Weights => Box::new(Highest { windows, pipeline: Pipeline::default() }),
            Self::Echofix => Box::new(Echofix::new(self, windows)),
            Self::Exact => Box::new(Echofix { engine: EngineKind::Bounded, ..Echofix::new(self, windows) }),
            Self::Rigid => {
                let mut rigid = Echofix::new(self, windows);
                rigid.search.drift =
                    Some(DriftPrior { position_mps: 1e-5, yaw_radps: 1e-6, temperature: 3.0 });
                Box::new(rigid)
            }
            Self::NoDoppler => Box::new(Echofix { movers: Movers::Included, ..Echofix::new(self, windows) }),
        }
    }
}

/// A cache of prepared maps, without those that were not used for the longest time.
pub struct Windows {
    images: Cache<(MapKey, MapSquare), Arc<MapImage>>,
    tiles: Cache<(MapKey, TileId), Arc<TileWeights>>,
    plans: Mutex<BTreeMap<usize, Arc<Plans>>>,
    search: Search,
}

impl Windows {
    /// An empty cache with room for so many mebibytes.
    pub fn new(mib: u64) -> Arc<Self> {
        let images = Cache::builder()
            .weigher(|_, image: &Arc<MapImage>| (image.bytes() >> 10) as u32)
            .max_capacity(mib << 9)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        let tiles = Cache::builder()
            .weigher(|_, tile: &Arc<TileWeights>| (tile.bytes() >> 10) as u32)
            .max_capacity(mib << 9)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        Arc::new(Self { images, tiles, plans: Mutex::default(), search: Search::default() })
    }

    fn square(&self, map: &RadarMap, prior: &Prior) -> MapSquare {
        let search_m = self.search.sigmas * prior.sigma_position_m;
        MapSquare::around(map.zone(), MapPoint::of(&prior.pose), self.search.extent_m, search_m)
    }

    /// The paper's occupancy grid around a prior, transformed.
    fn occupancy(&self, map: &RadarMap, square: MapSquare) -> Arc<MapImage> {
        let model = InverseSensorModel::default();
        let prepare =
            || Arc::new(MapImage::of_evidence(&map.window(square), &model, self.plans(square.side)));
        self.images.get_with((map.key, square), prepare)
    }

    /// The prepared tiles of a square.
    pub fn weights(&self, map: &RadarMap, square: MapSquare) -> Vec<Arc<TileWeights>> {
        let known = square.tiles().filter(|id| map.tile(*id).is_some());
        let prepare = |id| Arc::new(TileWeights::packed(id, |at| map.tile(at)));
        known.map(|id| self.tiles.get_with((map.key, id), || prepare(id))).collect()
    }

    fn plans(&self, side: usize) -> Arc<Plans> {
        // A thread that panics with the lock leaves the map whole.
        let mut plans = self.plans.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(plans.entry(side).or_insert_with(|| Arc::new(Plans::new(side))))
    }
}

/// The paper's method: the hypothesis of the highest correlation of the occupancy grids.
struct Paper {
    name: MethodName,
    windows: Arc<Windows>,
    workspace: CorrelationWorkspace,
    movers: Movers,
}

impl Paper {
    fn new(name: MethodName, windows: Arc<Windows>, movers: Movers) -> Self {
        Self { name, windows, workspace: CorrelationWorkspace::default(), movers }
    }
}

impl Method for Paper {
    fn name(&self) -> &'static str {
        self.name.word()
    }

    fn movers(&self) -> Movers {
        self.movers
    }

    fn fix(&mut self, map: &RadarMap, batch: &Batch, prior: &Prior) -> MethodAnswer {
        let search = self.windows.search;
        let image = self.windows.occupancy(map, self.windows.square(map, prior));
        let began = Instant::now();
        let (pose, correlation) = fast_global_align(&image, batch, prior, &search, &mut self.workspace);
        let elapsed = began.elapsed();
        let second = match correlation.highest(2, search.separation_m)[..] {
            [first, second] if correlation.values[first] > 0.0 => {
                f64::from(correlation.values[second] / correlation.values[first])
            }
            _ => 0.0,
        };
        MethodAnswer { second, elapsed, ..MethodAnswer::unjudged(pose) }
    }
}

/// The hypothesis of the highest sum of log weights, without refinement.
struct Highest {
    windows: Arc<Windows>,
    pipeline: Pipeline,
}

impl Method for Highest {
    fn name(&self) -> &'static str {
        MethodName::Weights.word()
    }

    fn movers(&self) -> Movers {
        Movers::Excluded
    }

    fn fix(&mut self, map: &RadarMap, batch: &Batch, prior: &Prior) -> MethodAnswer {
        let search = self.windows.search;
        let square = self.windows.square(map, prior);
        self.pipeline.assemble(square, &self.windows.weights(map, square));
        let began = Instant::now();
        // Points are not thinned: the exact engine counts the batch's cells.
        let found = self.pipeline.search(EngineKind::Bounded.engine(), batch, prior, &search);
        let elapsed = began.elapsed();
        let score = |rank: usize| found.get(rank).map_or(0.0, |candidate| candidate.score);
        let best = found.first().map_or(Pose2::IDENTITY, |candidate| candidate.correction);
        let second = if score(0) > 0.0 { score(1) / score(0) } else { 0.0 };
        MethodAnswer { second, elapsed, ..MethodAnswer::unjudged(prior.corrected(&best)) }
    }
}

/// The method of the service, whole or without one of its steps.
struct Echofix {
    name: MethodName,
    windows: Arc<Windows>,
    aligner: Aligner,
    engine: EngineKind,
    search: Search,
    movers: Movers,
}

impl Echofix {
    fn new(name: MethodName, windows: Arc<Windows>) -> Self {
        let search = windows.search;
        let (engine, movers) = (EngineKind::Fast, Movers::Excluded);
        Self { name, windows, aligner: Aligner::default(), engine, search, movers }
    }
}

impl Method for Echofix {
    fn name(&self) -> &'static str {
        self.name.word()
    }

    fn movers(&self) -> Movers {
        self.movers
    }

    fn fix(&mut self, map: &RadarMap, batch: &Batch, prior: &Prior) -> MethodAnswer {
        let integrity = Integrity::default();
        let square = self.windows.square(map, prior);
        let tiles = self.windows.weights(map, square);
        let began = Instant::now();
        let task = Task { square, tiles: &tiles, batch, prior };
        let answer = self.aligner.align(&task, self.engine.engine(), &self.search, &integrity);
        let elapsed = began.elapsed();
        let levels = answer.protection(&integrity, RISK);
        let finite = answer.covariance.iter().flatten().all(|v| v.is_finite());
        let protection =
            Protection { along_m: levels.along_m, cross_m: levels.cross_m, yaw_rad: levels.yaw_rad };
        MethodAnswer {
            pose: answer.pose,
            covariance: finite.then_some(answer.covariance),
            usable: answer.verdict == Verdict::Usable,
            verdict: verdict_word(&answer.verdict),
            protection: finite.then_some(protection),
            second: answer.alternatives.first().map_or(0.0, |(_, score)| *score),
            margin: Some(answer.margin),
            elapsed,
        }
    }
}
