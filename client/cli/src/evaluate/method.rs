//! The methods under test, and all that knows how they align.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

pub use echofix_core::align::Prior;
use echofix_core::align::fft::Plans;
use echofix_core::align::verdict::{Integrity, Verdict};
use echofix_core::align::{PreparedMap, Search, Workspace, align, fast_global_align, peaks};
use echofix_core::batch::Batch;
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_core::window::Frame;
use moka::policy::EvictionPolicy;
use moka::sync::Cache;

use super::map::{MapKey, Movers, RadarMap};

/// Integrity risk that protection levels are asked for.
pub const RISK: f64 = 1e-3;

/// Bounds of the error, at [`RISK`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Protection {
    /// Along the heading, metres.
    pub along_m: f64,
    /// Across it, metres.
    pub cross_m: f64,
    /// Radians.
    pub yaw_rad: f64,
}

/// What a method says.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Map metres and radians from grid east.
    pub pose: Pose2,
    /// Of (east m, north m, yaw rad), when the method knows one.
    pub covariance: Option<[[f64; 3]; 3]>,
    /// May it be used?
    pub usable: bool,
    /// Why (not).
    pub verdict: &'static str,
    /// When the method knows them.
    pub protection: Option<Protection>,
    /// Score of the best distinct alternative relative to the answer's; 0 without one.
    pub second: f64,
    /// Time of the fix itself, its window prepared.
    pub elapsed: Duration,
}

/// A way to find the pose of a batch on a map.
pub trait Method: Send {
    /// Its name in tables.
    fn name(&self) -> &'static str;
    /// What becomes of movers, in its map and in its batches.
    fn movers(&self) -> Movers;
    /// Finds the pose of a batch on a map.
    fn fix(&mut self, map: &RadarMap, batch: &Batch, prior: &Prior) -> Outcome;
}

/// A method by its name on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Name {
    /// The paper's: the hypothesis of the highest correlation.
    Paper,
    /// The service's.
    Echofix,
}

impl Name {
    /// The method, for one thread; `windows` is shared by all.
    pub fn method(self, windows: &Arc<Windows>) -> Box<dyn Method> {
        let (windows, workspace) = (Arc::clone(windows), Workspace::default());
        match self {
            Self::Paper => Box::new(Paper { windows, workspace }),
            Self::Echofix => Box::new(Echofix { windows, workspace }),
        }
    }
}

/// Prepared windows, the least recently used forgotten.
pub struct Windows {
    cache: Cache<(MapKey, Frame), Arc<PreparedMap>>,
    plans: Mutex<BTreeMap<usize, Arc<Plans>>>,
    search: Search,
}

impl Windows {
    /// Room for so many mebibytes.
    pub fn new(mib: u64) -> Arc<Self> {
        let cache = Cache::builder()
            .weigher(|_, map: &Arc<PreparedMap>| (map.bytes() >> 10) as u32)
            .max_capacity(mib << 10)
            .eviction_policy(EvictionPolicy::lru())
            .build();
        Arc::new(Self { cache, plans: Mutex::default(), search: Search::default() })
    }

    fn around(&self, map: &RadarMap, prior: &Prior) -> Arc<PreparedMap> {
        let search_m = self.search.sigmas * prior.sigma_position_m;
        let place = [prior.pose.x_m, prior.pose.y_m];
        let frame = Frame::around(map.zone(), place, self.search.extent_m, search_m);
        let prepare = || Arc::new(PreparedMap::new(map.window(frame), self.plans(frame.side), &self.search));
        self.cache.get_with((map.key, frame), prepare)
    }

    fn plans(&self, side: usize) -> Arc<Plans> {
        // A panic while holding the lock leaves a map that is still a map.
        let mut plans = self.plans.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(plans.entry(side).or_insert_with(|| Arc::new(Plans::new(side))))
    }
}

/// The paper's method as printed: the hypothesis of the highest correlation.
struct Paper {
    windows: Arc<Windows>,
    workspace: Workspace,
}

impl Method for Paper {
    fn name(&self) -> &'static str {
        "paper"
    }

    fn movers(&self) -> Movers {
        Movers::Kept
    }

    fn fix(&mut self, map: &RadarMap, batch: &Batch, prior: &Prior) -> Outcome {
        let (map, search) = (self.windows.around(map, prior), self.windows.search);
        let began = Instant::now();
        let correlation = fast_global_align(&map, batch, prior, &search, &mut self.workspace);
        let best = correlation.hypothesis(correlation.argmax());
        let elapsed = began.elapsed();
        let peaks = peaks::highest(&correlation, &search);
        let second = match peaks.as_slice() {
            [first, second, ..] if first.value > 0.0 => f64::from(second.value / first.value),
            _ => 0.0,
        };
        let pose = Pose2::new(
            prior.pose.x_m + best.x_m,
            prior.pose.y_m + best.y_m,
            wrap_angle(prior.pose.yaw_rad + best.yaw_rad),
        );
        let verdict = "NOT_JUDGED";
        Outcome { pose, covariance: None, usable: true, verdict, protection: None, second, elapsed }
    }
}

/// What the service answers.
struct Echofix {
    windows: Arc<Windows>,
    workspace: Workspace,
}

impl Method for Echofix {
    fn name(&self) -> &'static str {
        "echofix"
    }

    fn movers(&self) -> Movers {
        Movers::Dropped
    }

    fn fix(&mut self, map: &RadarMap, batch: &Batch, prior: &Prior) -> Outcome {
        let (map, integrity) = (self.windows.around(map, prior), Integrity::default());
        let began = Instant::now();
        let answer = align(&map, batch, prior, &self.windows.search, &integrity, &mut self.workspace);
        let elapsed = began.elapsed();
        let levels = answer.protection(&integrity, RISK);
        let finite = answer.covariance.iter().flatten().all(|v| v.is_finite());
        let protection =
            Protection { along_m: levels.along_m, cross_m: levels.cross_m, yaw_rad: levels.yaw_rad };
        Outcome {
            pose: answer.pose,
            covariance: finite.then_some(answer.covariance),
            usable: answer.verdict == Verdict::Usable,
            verdict: word(&answer.verdict),
            protection: finite.then_some(protection),
            second: answer.alternatives.first().map_or(0.0, |(_, score)| *score),
            elapsed,
        }
    }
}

fn word(verdict: &Verdict) -> &'static str {
    match verdict {
        Verdict::Usable => "USABLE",
        Verdict::Ambiguous { .. } => "AMBIGUOUS",
        Verdict::TooLittleStructure { .. } => "TOO_LITTLE_STRUCTURE",
        Verdict::DisagreesWithMap { .. } => "DISAGREES_WITH_MAP",
        Verdict::AtEdgeOfSearch => "AT_EDGE_OF_SEARCH",
        Verdict::TooLittleMap { .. } => "TOO_LITTLE_MAP",
    }
}
