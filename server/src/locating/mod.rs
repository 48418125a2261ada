//! Answers to "where am I?": the window of the map, a compute slot, the alignment, its bounds; and what such
//! answers can be expected to be.

mod cache;
mod config;
mod expectation;
mod slots;

use std::sync::Arc;
use std::time::{Duration, Instant};

pub use config::LocatingConfig;
use echofix_core::align::combine::turned;
use echofix_core::align::localizability::Expected;
use echofix_core::align::verdict::{Protection, Verdict};
use echofix_core::align::{Aligner, Alignment, EngineKind, Prior, Task};
use echofix_core::batch::Batch;
use echofix_core::geo::{self, Grid, LatLon, Zone};
use echofix_core::pose::Pose2;
use echofix_core::window::MapSquare;
pub use expectation::{Expectations, PLACES, TileExpectation};

use crate::store::{self, MapStore};
use cache::{Found, TileCache};
use slots::{Slot, Slots};

/// A batch, what the vehicle believes, and what it needs.
#[derive(Debug, Clone)]
pub struct Question {
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
    /// When the vehicle no longer waits.
    pub deadline: Option<Instant>,
    /// The integrity risk the protection levels must hold for; `None` for the service's default.
    pub integrity_risk: Option<f64>,
}

/// An alignment in words a vehicle understands.
#[derive(Debug, Clone)]
pub struct Answer {
    /// The alignment on the zone's grid.
    pub alignment: Alignment,
    /// The zone.
    pub zone: Zone,
    /// The correction found within the prior's sigmas: metres east and north on the grid, radians.
    pub found: Pose2,
    /// Corrected position.
    pub at: LatLon,
    /// Corrected heading, radians counter-clockwise from true east.
    pub yaw_rad: f64,
    /// Bounds of the error.
    pub protection: Protection,
    /// The integrity risk they hold for.
    pub integrity_risk: f64,
    /// True when the prior is combined into it.
    pub contains_prior: bool,
    /// True when the search was repeated over a wide area.
    pub searched_wide: bool,
    /// The map it rests on.
    pub map: MapUsed,
    /// Where the time went.
    pub timing: Timing,
}

/// The map an answer rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MapUsed {
    /// Its epoch.
    pub epoch: u64,
    /// Last UTC day anything was seen in the window, counted from the Unix epoch.
    pub newest_day: u16,
    /// Tiles in the window.
    pub tiles: usize,
    /// Occupied cells in the window.
    pub cells: usize,
}

/// Where the time went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Timing {
    /// Waiting for a compute slot.
    pub queued: Duration,
    /// Fetching tiles and preparing those that changed.
    pub window: Duration,
    /// Whether all came from the cache.
    pub window_cached: bool,
    /// Aligning.
    pub align: Duration,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    /// Nothing is served around the prior.
    #[error(
        "the map holds nothing within {reach_m:.0} m of the prior at {lat_deg:.6}, {lon_deg:.6}; check the prior, or drive and upload here first"
    )]
    NoMap {
        /// Half width of the window, metres.
        reach_m: f64,
        /// Degrees.
        lat_deg: f64,
        /// Degrees.
        lon_deg: f64,
    },
    /// The vehicle hardly moves.
    #[error(
        "the vehicle moves at {speed_mps:.2} m/s; radar at rest is mostly clutter, ask again above {least_mps} m/s"
    )]
    TooSlow {
        /// Metres per second.
        speed_mps: f64,
        /// The least speed, metres per second.
        least_mps: f64,
    },
    /// The batch is empty.
    #[error("the batch holds no detections; send the scans of the last seconds")]
    NoDetections,
    /// The gates left too few detections.
    #[error(
        "{kept} of {sent} detections are left after dropping {too_slow} taken too slowly, {too_far} too far away, {moving} movers and {without_pose} outside the odometry; {least} are needed: send a longer batch"
    )]
    TooFewDetections {
        /// Left.
        kept: usize,
        /// Sent.
        sent: u64,
        /// Dropped.
        too_slow: u64,
        /// Dropped.
        too_far: u64,
        /// Dropped.
        moving: u64,
        /// Dropped.
        without_pose: u64,
        /// Needed.
        least: usize,
    },
    /// The prior's sigma asks for a search wider than the service offers.
    #[error("the prior's sigma of {what} is {given:.3}; at most {most:.3} can be searched")]
    PriorTooUncertain {
        /// Position or heading, with its unit.
        what: &'static str,
        /// Given.
        given: f64,
        /// The most.
        most: f64,
    },
    /// The prior cannot be placed on the map.
    #[error(transparent)]
    Place(#[from] geo::Error),
    /// All compute slots and places in the queue are taken.
    #[error("{waiting} requests are waiting already; try again in {} ms", retry_after.as_millis())]
    Overloaded {
        /// Requests under way.
        waiting: usize,
        /// When to try again.
        retry_after: Duration,
    },
    /// The map cannot be read.
    #[error("the map cannot be read: {0}")]
    Store(Arc<store::Error>),
    /// The service is ending.
    #[error("the service is ending; ask another one")]
    Ending,
}

/// A compute slot, given back when dropped.
pub struct Admitted {
    slot: Slot,
    queued: Duration,
}

/// Answers questions from the map, on a bounded number of threads.
pub struct Locator {
    store: Arc<dyn MapStore>,
    config: LocatingConfig,
    tiles: TileCache,
    slots: Slots,
}

impl Locator {
    /// A locator over a map.
    #[must_use]
    pub fn new(store: Arc<dyn MapStore>, config: LocatingConfig) -> Self {
        let tiles = TileCache::new(config.tile_cache_mib);
        let slots = Slots::new(config.threads(), config.queue);
        Self { store, config, tiles, slots }
    }

    /// Its configuration.
    pub fn config(&self) -> &LocatingConfig {
        &self.config
    }

    /// Waits for a compute slot, in order of arrival. Take it before a request is decoded: that
    /// work is bounded by the slots, too.
    ///
    /// # Errors
    /// When too many wait already.
    pub async fn admit(&self) -> Result<Admitted, Refusal> {
        let waiting = Instant::now();
        let slot = self.slots.take().await?;
        Ok(Admitted { slot, queued: waiting.elapsed() })
    }

    /// Answers one question. Computes for a while: keep it off the async threads.
    ///
    /// # Errors
    /// What cannot be answered is refused with the reason.
    pub fn locate(&self, question: &Question, admitted: &mut Admitted) -> Result<Answer, Refusal> {
        self.check(question)?;
        let queued = admitted.queued;
        self.answer(question, admitted.slot.aligner(), queued)
    }

    /// Asks the question of an answer again, with the engine that tries every hypothesis. Takes some
    /// hundred times as long as the answer.
    ///
    /// # Errors
    /// When the map cannot be read any more.
    pub fn confirms(
        &self,
        question: &Question,
        answer: &Answer,
        admitted: &mut Admitted,
    ) -> Result<bool, Refusal> {
        let place = self.place(question)?;
        let found = self.tiles.get(&*self.store, place.frame).map_err(Refusal::Store)?;
        let task =
            Task { square: place.frame, tiles: &found.tiles, batch: &question.batch, prior: &place.prior };
        let (search, integrity) = (self.config.search(), self.config.integrity());
        let again = admitted.slot.aligner().align(&task, EngineKind::Fft.engine(), &search, &integrity);
        Ok(again.correction.distance_m(&answer.found) < CONFIRMED_WITHIN_M)
    }

    /// What needs no map to be refused.
    fn check(&self, question: &Question) -> Result<(), Refusal> {
        let Question { batch, sigma_position_m, sigma_yaw_rad, .. } = question;
        let LocatingConfig { max_sigma_position_m, max_sigma_yaw_deg, min_detections, min_speed_mps, .. } =
            self.config;
        if batch.detections == 0 {
            return Err(Refusal::NoDetections);
        }
        if batch.speed_mps < min_speed_mps {
            return Err(Refusal::TooSlow { speed_mps: batch.speed_mps, least_mps: min_speed_mps });
        }
        if batch.points.len() < min_detections {
            return Err(too_few(batch, min_detections));
        }
        let bound = |what, given: f64, most: f64| {
            // What is no number, as the root of an overflow, is within no limit.
            if given <= most { Ok(()) } else { Err(Refusal::PriorTooUncertain { what, given, most }) }
        };
        bound("the position (m)", *sigma_position_m, max_sigma_position_m)?;
        bound("the heading (rad)", *sigma_yaw_rad, max_sigma_yaw_deg.to_radians())
    }

    /// Tiles, alignment, bounds; blocks.
    fn answer(
        &self,
        question: &Question,
        aligner: &mut Aligner,
        queued: Duration,
    ) -> Result<Answer, Refusal> {
        let Place { grid, prior, frame } = self.place(question)?;
        let fetching = Instant::now();
        let found = self.tiles.get(&*self.store, frame).map_err(Refusal::Store)?;
        if found.tiles.is_empty() {
            return Err(no_map(frame, question.at));
        }
        let window = fetching.elapsed();
        let aligning = Instant::now();
        let (search, integrity) = (self.config.search(), self.config.integrity());
        let task = Task { square: frame, tiles: &found.tiles, batch: &question.batch, prior: &prior };
        let engine = EngineKind::from(self.config.engine).engine();
        let mut alignment = aligner.align(&task, engine, &search, &integrity);
        let correction = alignment.correction;
        let wide = self.searched_wide(question, &grid, &prior, &alignment, aligner)?;
        let searched_wide = wide.is_some();
        alignment = wide.unwrap_or(alignment);
        let combined = question.combine && alignment.verdict == Verdict::Usable;
        // The prior is told in true east and north, the alignment in the grid's.
        let told = turned(&question.covariance, grid.convergence_rad(question.at)?);
        let combined = combined.then(|| alignment.combined(&prior.pose, &told)).flatten();
        let contains_prior = combined.is_some();
        alignment = combined.unwrap_or(alignment);
        let align = aligning.elapsed();
        let (at, yaw_rad) = grid.pose_to_geodetic(&alignment.pose)?;
        let integrity_risk = question.integrity_risk.unwrap_or(self.config.integrity_risk);
        Ok(Answer {
            protection: alignment.protection(&integrity, integrity_risk),
            alignment,
            found: correction,
            zone: grid.zone(),
            at,
            yaw_rad,
            integrity_risk,
            contains_prior,
            searched_wide,
            map: used(&found),
            timing: Timing { queued, window, window_cached: found.cached, align },
        })
    }

    /// The prior on its grid, and the square around it.
    fn place(&self, question: &Question) -> Result<Place, Refusal> {
        let grid = Grid::of(question.at)?;
        let prior = Prior {
            pose: grid.pose_from_geodetic(question.at, question.yaw_rad)?,
            sigma_position_m: question.sigma_position_m,
            sigma_yaw_rad: question.sigma_yaw_rad,
            scale: grid.scale_factor(question.at)?,
        };
        let frame = self.frame(&grid, &prior);
        Ok(Place { grid, prior, frame })
    }

    fn frame(&self, grid: &Grid, prior: &Prior) -> MapSquare {
        let search = self.config.search();
        let reach_m = search.sigmas * prior.sigma_position_m;
        MapSquare::around(grid.zone(), [prior.pose.x_m, prior.pose.y_m], search.extent_m, reach_m)
    }

    /// A search of a wide area with all headings, when the answer lies on the edge of the prior's or
    /// nothing there explains the batch, and there is time for it. What it finds, far from where the
    /// vehicle believes to be, is to be asked for again, not to be used.
    fn searched_wide(
        &self,
        question: &Question,
        grid: &Grid,
        prior: &Prior,
        answer: &Alignment,
        aligner: &mut Aligner,
    ) -> Result<Option<Alignment>, Refusal> {
        let astray = matches!(answer.verdict, Verdict::PriorOutsideSearch | Verdict::Lost { .. });
        let late =
            question.deadline.is_some_and(|at| at.saturating_duration_since(Instant::now()) < WIDE_TAKES);
        let (search, integrity) = (self.config.search(), self.config.integrity());
        if !astray || late || self.config.wide_search_m <= search.sigmas * prior.sigma_position_m {
            return Ok(None);
        }
        let wide = Prior {
            sigma_position_m: self.config.wide_search_m / search.sigmas,
            sigma_yaw_rad: std::f64::consts::PI / search.sigmas,
            ..*prior
        };
        let frame = self.frame(grid, &wide);
        let found = self.tiles.get(&*self.store, frame).map_err(Refusal::Store)?;
        let task = Task { square: frame, tiles: &found.tiles, batch: &question.batch, prior: &wide };
        let mut elsewhere = aligner.align(&task, EngineKind::Fast.engine(), &search, &integrity);
        if elsewhere.verdict == Verdict::Usable {
            elsewhere.verdict = Verdict::PriorOutsideSearch;
        }
        Ok(Some(elsewhere))
    }
}

/// A prior on the map.
struct Place {
    grid: Grid,
    prior: Prior,
    frame: MapSquare,
}

/// Two engines agree when their answers lie this near, metres.
const CONFIRMED_WITHIN_M: f64 = 0.2;
/// Time that a wide search is given.
const WIDE_TAKES: Duration = Duration::from_millis(100);

fn used(found: &Found) -> MapUsed {
    MapUsed {
        epoch: found.epoch,
        newest_day: found.tiles.iter().map(|t| t.newest_day).max().unwrap_or(0),
        tiles: found.tiles.len(),
        cells: found.tiles.iter().map(|t| t.cells).sum(),
    }
}

fn too_few(batch: &Batch, least: usize) -> Refusal {
    let dropped = batch.dropped;
    Refusal::TooFewDetections {
        kept: batch.points.len(),
        sent: batch.detections,
        too_slow: dropped.too_slow,
        too_far: dropped.too_far,
        moving: dropped.moving,
        without_pose: dropped.without_pose,
        least,
    }
}

fn no_map(frame: MapSquare, at: LatLon) -> Refusal {
    let reach_m = frame.side as f64 * geo::CELL_M / 2.0;
    Refusal::NoMap { reach_m, lat_deg: at.lat_deg, lon_deg: at.lon_deg }
}

/// The contract's word for what a fix will most likely be told, without its prefix.
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
