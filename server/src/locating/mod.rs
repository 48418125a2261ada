//! Fixes: the map window, a compute slot, the alignment, its protection levels; and localizability, what a fix can be
//! expected to be.

mod config;
mod expectation;
mod prepared_tiles;
mod slots;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

pub use config::LocatingConfig;
use echofix_core::align::combine::turned;
use echofix_core::align::localizability::Expected;
use echofix_core::align::verdict::{Protection, Verdict};
use echofix_core::align::{Aligner, Alignment, EngineKind, Prior, Task};
use echofix_core::batch::Batch;
use echofix_core::convention::{Convention, in_words};
use echofix_core::geo::{self, Grid, LatLon, Zone};
use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;
use echofix_core::window::MapSquare;
pub use expectation::{Expectations, NotAssessed, SPOTS_PER_SIDE, TileExpectation};
use tracing::Instrument;

use crate::export::part;
use crate::patience::Patience;
use crate::store::{self, MapStore, Withheld};
pub use prepared_tiles::CacheFigures;
use prepared_tiles::{PreparedTiles, PreparedWindow};
pub use slots::Arriving;
use slots::{ComputeSlot, ComputeSlots};

/// A batch, what the vehicle believes, and what it needs.
#[derive(Debug, Clone)]
pub struct LocateRequest {
    /// What it saw, gated and organised.
    pub batch: Batch,
    /// Where it believes to be at the batch's reference time.
    pub at: LatLon,
    /// Its heading, radians counter-clockwise from true east.
    pub yaw_rad: f64,
    /// Covariance of what it believes: (true east m, true north m, yaw rad).
    pub covariance: [[f64; 3]; 3],
    /// Its sigma of the position along its longest axis, metres.
    pub sigma_position_m: f64,
    /// Its sigma of the heading, radians.
    pub sigma_yaw_rad: f64,
    /// Shall the answer contain what it believes?
    pub combine: bool,
    /// How long the vehicle waits.
    pub patience: Patience,
    /// The integrity risk the protection levels must hold for; `None` for the service's default.
    pub integrity_risk: Option<f64>,
}

/// An alignment with what a vehicle needs of it: geodetic pose, protection levels, the map it rests on.
#[derive(Debug, Clone)]
pub struct LocateAnswer {
    /// The alignment on the zone's grid.
    pub alignment: Alignment,
    /// The UTM zone whose grid the alignment is on.
    pub zone: Zone,
    /// The correction found within the prior's sigmas: metres east and north on the grid, radians.
    pub found: Pose2,
    /// The corrected position.
    pub at: LatLon,
    /// Corrected heading, radians counter-clockwise from true east.
    pub yaw_rad: f64,
    /// Protection levels: what bounds the error, no more often exceeded than `integrity_risk`.
    pub protection: Protection,
    /// The integrity risk that the protection levels hold for.
    pub integrity_risk: f64,
    /// True when the prior is combined into it.
    pub contains_prior: bool,
    /// True when the pose was found by relocalization.
    pub relocalized: bool,
    /// The map it rests on.
    pub map: MapUsed,
    /// How long its parts took.
    pub timing: Timing,
}

/// The map an answer rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MapUsed {
    /// Epoch of the map when the window was made.
    pub epoch: u64,
    /// Last UTC day anything was seen in the window, counted from the Unix epoch.
    pub newest_day: u16,
    /// Tiles in the window.
    pub tiles: usize,
    /// Occupied cells in the window.
    pub cells: usize,
}

/// How long the parts of an answer took.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Timing {
    /// Waiting for a compute slot.
    pub queued: Duration,
    /// Fetching tiles and preparing those that changed.
    pub window: Duration,
    /// Whether all came from the cache.
    pub window_cached: bool,
    /// Aligning the batch, with any relocalization.
    pub align: Duration,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum LocateRefusal {
    /// Nothing is served around the prior.
    #[error(
        "the map holds nothing within {reach_m:.0} m of the prior at {lat_deg:.6}, {lon_deg:.6}; {}",
        where_to_look(*.swapped, *.withheld)
    )]
    NoMap {
        /// Half width of the window, metres.
        reach_m: f64,
        /// The prior, degrees north.
        lat_deg: f64,
        /// The prior, degrees east.
        lon_deg: f64,
        /// Whether there is a map where the two are exchanged.
        swapped: bool,
        /// What was seen here and is not served yet.
        withheld: Option<Withheld>,
    },
    /// The vehicle hardly moves.
    #[error(
        "the vehicle moves at {speed_mps:.2} m/s; radar at rest is mostly clutter, ask again above {least_mps} m/s"
    )]
    TooSlow {
        /// The vehicle's mean speed over the batch, metres per second.
        speed_mps: f64,
        /// The least speed, metres per second.
        least_mps: f64,
    },
    /// The batch is empty.
    #[error("the batch holds no detections; send the scans of the last seconds")]
    NoDetections,
    /// The gates left too few detections.
    #[error(
        "{kept} of {sent} detections are left after dropping {too_slow} taken too slowly, {too_far} too far away, {moving} movers and {without_pose} outside the odometry; {least} are needed: {}",
        advice(.findings)
    )]
    TooFewDetections {
        /// Detections left after the gates.
        kept: usize,
        /// Detections in the request.
        sent: u64,
        /// Dropped: taken while the vehicle was too slow.
        too_slow: u64,
        /// Dropped: farther away than the gate.
        too_far: u64,
        /// Dropped: movers.
        moving: u64,
        /// Dropped: taken when there was no odometry.
        without_pose: u64,
        /// Detections that are needed.
        least: usize,
        /// What seems to be wrong with the batch, in words.
        findings: String,
    },
    /// The batch seems to be in another convention than the contract's.
    #[error("the batch seems to be in another convention than the contract's: {0}")]
    WrongConvention(String),
    /// The prior's sigma asks for a search wider than the service offers.
    #[error("the prior's sigma of {what} is {given:.3}; at most {most:.3} can be searched")]
    PriorTooUncertain {
        /// Position or heading, with its unit.
        what: &'static str,
        /// The prior's sigma.
        given: f64,
        /// The largest sigma that is searched.
        most: f64,
    },
    /// The prior lies where there is no UTM zone.
    #[error(transparent)]
    Place(#[from] geo::Error),
    /// All compute slots are taken and the queue is full.
    #[error("{waiting} requests are waiting already; try again in {} ms", retry_after.as_millis())]
    Overloaded {
        /// Requests that run or wait.
        waiting: usize,
        /// How long to wait before the next attempt.
        retry_after: Duration,
    },
    /// The map cannot be read.
    #[error("the map cannot be read: {0}")]
    Store(Arc<store::Error>),
    /// The service is ending.
    #[error("the service is ending; ask another one")]
    Ending,
    /// Nobody waits for the answer any more.
    #[error("the caller no longer waits")]
    Gone,
}

/// A compute slot, given back when dropped.
pub struct Admitted {
    slot: ComputeSlot,
    queued: Duration,
}

/// Answers requests from the map, on a bounded number of threads.
pub struct Locator {
    store: Arc<dyn MapStore>,
    config: LocatingConfig,
    tiles: Arc<PreparedTiles>,
    slots: ComputeSlots,
    checker: Mutex<Aligner>,
}

impl Locator {
    /// A locator over a map.
    #[must_use]
    pub fn new(store: Arc<dyn MapStore>, config: LocatingConfig) -> Self {
        let tiles = Arc::new(PreparedTiles::new(config.tile_cache_mib));
        let ahead = Arc::clone(&tiles);
        store.before_serving(Box::new(move |upcoming| ahead.prepare_ahead(upcoming)));
        let slots = ComputeSlots::new(config.threads(), config.queue);
        Self { store, config, tiles, slots, checker: Mutex::default() }
    }

    /// What its cache of prepared tiles holds.
    pub fn cache(&self) -> CacheFigures {
        self.tiles.figures()
    }

    /// How it locates: the `[locating]` section.
    pub fn config(&self) -> &LocatingConfig {
        &self.config
    }

    /// A place for a request of which only the headers are here.
    ///
    /// # Errors
    /// When all are taken: then its body need not be received.
    pub fn expect(&self) -> Result<Arriving, LocateRefusal> {
        self.slots.expect()
    }

    /// Waits for a compute slot, in order of arrival. Take it before a request is decoded: that
    /// work is bounded by the slots, too.
    ///
    /// # Errors
    /// When too many wait already.
    pub async fn admit(&self) -> Result<Admitted, LocateRefusal> {
        let waiting = Instant::now();
        let slot = self.slots.take().instrument(part!("queue")).await?;
        Ok(Admitted { slot, queued: waiting.elapsed() })
    }

    /// Answers one request. Computes for a while: keep it off the async threads.
    ///
    /// # Errors
    /// What cannot be answered is refused with the reason.
    pub fn locate(
        &self,
        request: &LocateRequest,
        admitted: &mut Admitted,
    ) -> Result<LocateAnswer, LocateRefusal> {
        self.check(request)?;
        if request.patience.is_over() {
            return Err(LocateRefusal::Gone);
        }
        let queued = admitted.queued;
        self.answer(request, admitted.slot.aligner(), queued)
    }

    /// Repeats a request with the engine that tries every hypothesis: does it find the same? Takes some hundred times as
    /// long as the answer.
    ///
    /// # Errors
    /// When the map cannot be read any more.
    pub fn check_sample(
        &self,
        request: &LocateRequest,
        answer: &LocateAnswer,
    ) -> Result<bool, LocateRefusal> {
        // Beside the slots: who waits for one must not wait for a check. One at a time, whose buffers remain.
        let mut checker = self.checker.lock().unwrap_or_else(PoisonError::into_inner);
        let placed = self.placed_prior(request)?;
        let found = self.tiles.get(&*self.store, placed.frame).map_err(LocateRefusal::Store)?;
        let task =
            Task { square: placed.frame, tiles: &found.tiles, batch: &request.batch, prior: &placed.prior };
        let (search, integrity) = (self.config.search(), self.config.integrity());
        let again = checker.align(&task, EngineKind::Fft.engine(), &search, &integrity);
        Ok(again.correction.distance_m(&answer.found) < AGREES_WITHIN_M)
    }

    /// What needs no map to be refused.
    fn check(&self, request: &LocateRequest) -> Result<(), LocateRefusal> {
        let LocateRequest { batch, sigma_position_m, sigma_yaw_rad, .. } = request;
        let LocatingConfig { max_sigma_position_m, max_sigma_yaw_deg, min_detections, min_speed_mps, .. } =
            self.config;
        if batch.detections == 0 {
            return Err(LocateRefusal::NoDetections);
        }
        if batch.speed_mps < min_speed_mps {
            return Err(LocateRefusal::TooSlow { speed_mps: batch.speed_mps, least_mps: min_speed_mps });
        }
        if batch.points.len() < min_detections {
            return Err(too_few(batch, min_detections));
        }
        // What is left of a batch in another convention fits by chance, if at all.
        if batch.findings.iter().any(|finding| !finding.suspects().is_empty()) {
            return Err(LocateRefusal::WrongConvention(in_words(&batch.findings)));
        }
        let bound = |what, given: f64, most: f64| {
            // What is no number, as the root of an overflow, is within no limit.
            if given <= most { Ok(()) } else { Err(LocateRefusal::PriorTooUncertain { what, given, most }) }
        };
        bound("the position (m)", *sigma_position_m, max_sigma_position_m)?;
        bound("the heading (rad)", *sigma_yaw_rad, max_sigma_yaw_deg.to_radians())
    }

    /// Why nothing is served around a prior.
    fn no_map(&self, frame: MapSquare, at: LatLon, swapped: bool) -> LocateRefusal {
        let reach_m = frame.side as f64 * geo::CELL_M / 2.0;
        let (x, y) = prepared_tiles::block(frame);
        // What cannot be read now is no reason for another answer.
        let withheld = self.store.withheld(frame.zone, x, y).ok().flatten();
        LocateRefusal::NoMap { reach_m, lat_deg: at.lat_deg, lon_deg: at.lon_deg, swapped, withheld }
    }

    /// Tiles, alignment, bounds; blocks.
    fn answer(
        &self,
        request: &LocateRequest,
        aligner: &mut Aligner,
        queued: Duration,
    ) -> Result<LocateAnswer, LocateRefusal> {
        let PlacedPrior { grid, prior, frame } = self.placed_prior(request)?;
        let fetching = Instant::now();
        let found = part!("map").in_scope(|| self.tiles.get(&*self.store, frame));
        let found = found.map_err(LocateRefusal::Store)?;
        if found.tiles.is_empty() {
            let swapped = self.knows_exchanged(request);
            return Err(self.no_map(frame, request.at, swapped));
        }
        if request.patience.is_over() {
            return Err(LocateRefusal::Gone);
        }
        let window = fetching.elapsed();
        let aligning = Instant::now();
        let (search, integrity) = (self.config.search(), self.config.integrity());
        let task = Task { square: frame, tiles: &found.tiles, batch: &request.batch, prior: &prior };
        let engine = EngineKind::from(self.config.engine).engine();
        let mut alignment = part!("align").in_scope(|| aligner.align(&task, engine, &search, &integrity));
        let correction = alignment.correction;
        let wide =
            part!("relocalize").in_scope(|| self.relocalize(request, &grid, &prior, &alignment, aligner))?;
        let relocalized = wide.is_some();
        alignment = wide.unwrap_or(alignment);
        let combined = request.combine && alignment.verdict == Verdict::Usable;
        // The prior is in true east and north, the alignment in the grid's.
        let covariance = turned(&request.covariance, grid.convergence_rad(request.at)?);
        let combined = combined.then(|| alignment.combined(&prior.pose, &covariance)).flatten();
        let contains_prior = combined.is_some();
        alignment = combined.unwrap_or(alignment);
        let align = aligning.elapsed();
        let (at, yaw_rad) = grid.pose_to_geodetic(&alignment.pose)?;
        let integrity_risk = request.integrity_risk.unwrap_or(self.config.integrity_risk);
        Ok(LocateAnswer {
            protection: alignment.protection(&integrity, integrity_risk),
            alignment,
            found: correction,
            zone: grid.zone(),
            at,
            yaw_rad,
            integrity_risk,
            contains_prior,
            relocalized,
            map: used(&found),
            timing: Timing { queued, window, window_cached: found.cached, align },
        })
    }

    /// Is there a map where the prior's latitude and longitude are exchanged?
    fn knows_exchanged(&self, request: &LocateRequest) -> bool {
        let at = LatLon { lat_deg: request.at.lon_deg, lon_deg: request.at.lat_deg };
        let Ok(placed) = self.placed_prior(&LocateRequest { at, ..request.clone() }) else { return false };
        self.tiles.get(&*self.store, placed.frame).is_ok_and(|found| !found.tiles.is_empty())
    }

    /// The prior on its grid, and the square around it.
    fn placed_prior(&self, request: &LocateRequest) -> Result<PlacedPrior, LocateRefusal> {
        let grid = Grid::of(request.at)?;
        let prior = Prior {
            pose: grid.pose_from_geodetic(request.at, request.yaw_rad)?,
            sigma_position_m: request.sigma_position_m,
            sigma_yaw_rad: request.sigma_yaw_rad,
            scale: grid.scale_factor(request.at)?,
        };
        let frame = self.frame(&grid, &prior);
        Ok(PlacedPrior { grid, prior, frame })
    }

    fn frame(&self, grid: &Grid, prior: &Prior) -> MapSquare {
        let search = self.config.search();
        let reach_m = search.sigmas * prior.sigma_position_m;
        MapSquare::around(grid.zone(), MapPoint::of(&prior.pose), search.extent_m, reach_m)
    }

    /// Relocalization: a search of a wide area with all headings, when the answer lies on the edge of the prior's search, the
    /// prior hardly expects it or nothing there explains the batch, and there is time for it. What it finds, far from the
    /// prior, is to be asked for again, not to be used.
    fn relocalize(
        &self,
        request: &LocateRequest,
        grid: &Grid,
        prior: &Prior,
        answer: &Alignment,
        aligner: &mut Aligner,
    ) -> Result<Option<Alignment>, LocateRefusal> {
        let not_found = matches!(answer.verdict, Verdict::PriorOutsideSearch | Verdict::Lost { .. });
        let late = !request.patience.lasts(RELOCALIZATION_TIME);
        let (search, integrity) = (self.config.search(), self.config.integrity());
        if !not_found || late || self.config.wide_search_m <= search.sigmas * prior.sigma_position_m {
            return Ok(None);
        }
        let wide = Prior {
            sigma_position_m: self.config.wide_search_m / search.sigmas,
            sigma_yaw_rad: std::f64::consts::PI / search.sigmas,
            ..*prior
        };
        let frame = self.frame(grid, &wide);
        let found = self.tiles.get(&*self.store, frame).map_err(LocateRefusal::Store)?;
        let task = Task { square: frame, tiles: &found.tiles, batch: &request.batch, prior: &wide };
        let mut elsewhere = aligner.align(&task, EngineKind::Fast.engine(), &search, &integrity);
        if elsewhere.verdict == Verdict::Usable {
            elsewhere.verdict = Verdict::PriorOutsideSearch;
        }
        Ok(Some(elsewhere))
    }
}

/// A prior on the map.
struct PlacedPrior {
    grid: Grid,
    prior: Prior,
    frame: MapSquare,
}

/// Two engines agree when their answers lie this near, metres.
const AGREES_WITHIN_M: f64 = 0.2;
/// Time that a relocalization takes.
const RELOCALIZATION_TIME: Duration = Duration::from_millis(100);

/// What to do about too few detections.
fn advice(findings: &str) -> &str {
    if findings.is_empty() { "send a longer batch" } else { findings }
}

/// What to do about a prior beside the map.
fn where_to_look(swapped: bool, withheld: Option<Withheld>) -> String {
    match withheld {
        Some(Withheld { contributors, needed }) if contributors < needed => {
            let who = if contributors == 1 { "contributor" } else { "contributors" };
            format!("it was seen by {contributors} {who}, and is served once {needed} have seen it")
        }
        Some(_) => "what was seen here has faded, or is not confirmed by enough contributors".to_owned(),
        None if swapped => Convention::LatLonSwapped.question().to_owned(),
        None => {
            "nobody has uploaded anything here; check the prior, or drive and upload here first".to_owned()
        }
    }
}

fn used(found: &PreparedWindow) -> MapUsed {
    MapUsed {
        epoch: found.epoch,
        newest_day: found.tiles.iter().map(|t| t.newest_day).max().unwrap_or(0),
        tiles: found.tiles.len(),
        cells: found.tiles.iter().map(|t| t.cells).sum(),
    }
}

fn too_few(batch: &Batch, least: usize) -> LocateRefusal {
    let dropped = batch.dropped;
    LocateRefusal::TooFewDetections {
        kept: batch.points.len(),
        sent: batch.detections,
        too_slow: dropped.too_slow,
        too_far: dropped.too_far,
        moving: dropped.moving,
        without_pose: dropped.without_pose,
        least,
        findings: in_words(&batch.findings),
    }
}

/// The contract's word for the status that a fix will most likely get, without its prefix.
#[must_use]
pub fn expected_word(expected: Expected) -> &'static str {
    match expected {
        Expected::Usable => "USABLE",
        Expected::Ambiguous => "AMBIGUOUS",
        Expected::TooLittleStructure => "TOO_LITTLE_STRUCTURE",
    }
}

/// The contract's word for a verdict, without its prefix.
#[must_use]
pub fn verdict_word(verdict: &Verdict) -> &'static str {
    match verdict {
        Verdict::Usable => "USABLE",
        Verdict::Ambiguous { along_track: false, .. } => "AMBIGUOUS",
        Verdict::Ambiguous { along_track: true, .. } => "AMBIGUOUS_ALONG_TRACK",
        Verdict::TooLittleStructure { .. } => "TOO_LITTLE_STRUCTURE",
        Verdict::MapStale { .. } => "MAP_STALE",
        Verdict::PriorOutsideSearch => "PRIOR_OUTSIDE_SEARCH",
        Verdict::Lost { .. } => "LOST",
        Verdict::TooLittleMap { .. } => "TOO_LITTLE_MAP",
    }
}
