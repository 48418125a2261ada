//! Lost vehicles: what relocalization finds, and what it costs.

use std::f64::consts::PI;

use echofix_core::align::verdict::Verdict;
use echofix_core::align::{Aligner, Alignment, EngineKind, Search, Task};
use echofix_core::geo::Grid;
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_proto::v1::{self, GeodeticPose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::case::Case;
use super::inside::{InProcessService, timed};
use super::town::BenchTown;
use echofix_harness::percentiles::Percentiles;

/// A pose is right within these limits: metres and degrees.
const RIGHT: (f64, f64) = (1.0, 3.0);

/// The results of relocalizations.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Lost {
    /// Largest error of the priors, east and north, metres. Their headings are random.
    pub off_m: f64,
    /// Number of requests.
    pub asked: usize,
    /// Number of requests whose pose is right.
    pub found: usize,
    /// Number of right poses that the verdict calls usable.
    pub trusted: usize,
    /// Number of wrong poses that the verdict calls usable.
    pub misled: usize,
    /// Milliseconds of a fix: search, refinement and verdict.
    pub fix_ms: Option<Percentiles>,
}

/// Localizes vehicles that are lost, so many times.
///
/// # Errors
/// When a request is malformed or the map cannot be read.
pub(super) fn measure(
    parts: &InProcessService,
    town: &BenchTown,
    questions: usize,
    seed: u64,
) -> anyhow::Result<Lost> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut aligner = Aligner::default();
    let mut lost = Lost { off_m: parts.wide_search_m(), asked: questions, ..Lost::default() };
    let mut fixes = Vec::new();
    for index in 0..questions {
        let LostQuestion { case, true_pose } =
            lost_question(parts, town, index % town.recording.count(), &mut rng)?;
        if index == 0 {
            // The first alignment fills the buffers.
            answer(&case, &mut aligner);
        }
        let (fix_ms, answer) = answer(&case, &mut aligner);
        fixes.push(fix_ms);
        lost.count(&answer, &true_pose);
    }
    Ok(Lost { fix_ms: Percentiles::of(fixes), ..lost })
}

impl Lost {
    fn count(&mut self, answer: &Alignment, true_pose: &Pose2) {
        let off_deg = wrap_angle(answer.pose.yaw_rad - true_pose.yaw_rad).abs().to_degrees();
        let right = answer.pose.distance_m(true_pose) < RIGHT.0 && off_deg < RIGHT.1;
        let trusted = answer.verdict == Verdict::Usable;
        self.found += usize::from(right);
        self.trusted += usize::from(right && trusted);
        self.misled += usize::from(!right && trusted);
    }
}

/// The alignment of a lost vehicle.
struct LostQuestion {
    case: Case,
    true_pose: Pose2,
}

fn lost_question(
    parts: &InProcessService,
    town: &BenchTown,
    index: usize,
    rng: &mut ChaCha8Rng,
) -> anyhow::Result<LostQuestion> {
    let truth = town.recording.true_pose(index);
    let grid = Grid::of(truth.at)?;
    let true_pose = grid.pose_from_geodetic(truth.at, truth.yaw_rad)?;
    let off_m = parts.wide_search_m();
    let mut off = |most: f64| rng.random_range(-most..most);
    let believed =
        Pose2::new(true_pose.x_m + off(off_m), true_pose.y_m + off(off_m), true_pose.yaw_rad + off(PI));
    let (at, yaw_rad) = grid.pose_to_geodetic(&believed)?;
    let mut request = town.recording.question(index).request.clone();
    let sigmas = Search::default().sigmas;
    request.prior = Some(v1::Prior {
        pose: Some(GeodeticPose { latitude_deg: at.lat_deg, longitude_deg: at.lon_deg, yaw_rad }),
        sigma_position_m: off_m / sigmas,
        sigma_yaw_rad: PI / sigmas,
        ..v1::Prior::default()
    });
    Ok(LostQuestion { case: parts.case(&request)?, true_pose })
}

/// Milliseconds of a fix with its map window, search, refinement and verdict, and its result.
fn answer(case: &Case, aligner: &mut Aligner) -> (f64, Alignment) {
    let Case { square, tiles, batch, prior, search, integrity } = case;
    let task = Task { square: *square, tiles, batch, prior };
    timed(|| aligner.align(&task, EngineKind::Fast.engine(), search, integrity))
}
