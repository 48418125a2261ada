//! Where the parts of an upload lie on the map.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Matrix3;

use super::MapSide;
use super::part::UploadPart;
use crate::align::engine::{Candidate, Stepped};
use crate::align::pipeline::Pipeline;
use crate::align::ranking::Ranking;
use crate::align::refine::{RefinedCandidate, refine};
use crate::align::weights::TileWeights;
use crate::align::{Prior, Search};
use crate::batch::Batch;
use crate::geo::TileId;
use crate::point::{MapPoint, WeightedPoint};
use crate::pose::Pose2;
use crate::window::MapSquare;

/// How parts are made and matched with the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchingLimits {
    /// Cells farther from a part's middle belong to another part, metres.
    pub extent_m: f64,
    /// Half width of the search, metres.
    pub reach_m: f64,
    /// Half width of the search, radians.
    pub reach_yaw_rad: f64,
    /// Thinned points a part must have to be matched.
    pub min_points: usize,
    /// Independent returns count for this many points, where candidates are compared.
    pub score_temperature: f64,
    /// The same for the curvature of the score, on squared weights.
    pub temperature: f64,
    /// A candidate within this distance of the expected position, metres, is chosen unless another one exceeds it
    /// by [`MatchingLimits::min_margin`].
    pub near_m: f64,
    /// The same for the turn, radians.
    pub near_yaw_rad: f64,
    /// Nats by which a candidate must exceed those elsewhere to be distinct.
    pub min_margin: f64,
    /// A point lies where the map knows something when a map point is this near, metres.
    pub covered_within_m: f64,
}

impl Default for MatchingLimits {
    fn default() -> Self {
        Self {
            extent_m: 45.0,
            reach_m: 6.4,
            reach_yaw_rad: 4_f64.to_radians(),
            min_points: 300,
            score_temperature: 10.0,
            temperature: 2.0,
            near_m: 0.5,
            near_yaw_rad: 1_f64.to_radians(),
            min_margin: 12.0,
            covered_within_m: 2.0,
        }
    }
}

/// How a part matches the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PartMatch {
    /// How far it lies from its expected position: to be added to its positions besides, so that they lie
    /// on the map; metres east and north, radians about its middle.
    pub error: Pose2,
    /// Covariance of (east m, north m, yaw rad); infinite where the map does not determine it.
    pub covariance: Matrix3<f64>,
    /// Points that it was thinned to.
    pub points: usize,
    /// Fraction of them near which the map has anything.
    pub coverage: f64,
    /// Score relative to that of a random shift.
    pub contrast: f64,
    /// Log-likelihood by which the chosen candidate exceeds the best one elsewhere, nats; negative when it was
    /// chosen for being near the expected position.
    pub margin: f64,
    /// True when it lies on the edge of the search.
    pub at_edge: bool,
    /// Of a part that was matched elsewhere than expected, what its places say; `None` of one that was matched near there.
    pub elsewhere: Option<Places>,
}

/// What the places of a part say of where it lies, in standard errors: a score's difference, summed up place by place, against
/// how it scatters from place to place. Neighbouring returns, and what a vehicle saw again and again where it stood or
/// crawled, are one place: they make no difference surer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Places {
    /// How far they agree that it fits where it was matched better than where it was expected, and better than at the best
    /// candidate elsewhere: the lesser of the two.
    pub clear: f64,
    /// How far they agree that it fits where it was expected better than at a random shift.
    pub at_home: f64,
}

impl Places {
    fn of(ranking: &Ranking, best: &RefinedCandidate, limits: &MatchingLimits) -> Option<Self> {
        let home = home(ranking, limits).map_or(EXPECTED.correction, |home| home.correction);
        if best.correction == home {
            return None;
        }
        let question = &ranking.question;
        let (prior, field) = (question.prior, &ranking.field);
        let value = |point: &WeightedPoint, correction: &Pose2| {
            field.value(std::iter::once(point), &prior.corrected(correction), prior.scale)
        };
        let better = |there: &Pose2| {
            errors(question.thinned, |point| value(point, &best.correction) - value(point, there))
        };
        let next =
            ranking.best_beyond(&best.correction).map_or(f64::INFINITY, |next| better(&next.correction));
        let shifts: Vec<Pose2> = (0..25)
            .map(|i| [i % 5 - 2, i / 5 - 2].map(|step| 0.5 * limits.reach_m * f64::from(step)))
            .map(|[x, y]| Pose2::new(x, y, 0.0))
            .collect();
        let above = |point: &WeightedPoint| {
            let mean = shifts.iter().map(|shift| value(point, shift)).sum::<f64>() / shifts.len() as f64;
            value(point, &home) - mean
        };
        Some(Self { clear: better(&home).min(next), at_home: errors(question.thinned, above) })
    }
}

/// The sum over places, in standard errors of it.
fn errors(points: &[WeightedPoint], of: impl Fn(&WeightedPoint) -> f64) -> f64 {
    let mut places: BTreeMap<[i32; 2], f64> = BTreeMap::new();
    for point in points {
        let place = [point.x_m, point.y_m].map(|along| (along / PLACE_M).floor() as i32);
        *places.entry(place).or_default() += of(point);
    }
    let (sum, squares) = places.values().fold((0.0, 0.0), |(sum, squares), d| (sum + d, squares + d * d));
    if squares > 0.0 { sum / f64::sqrt(squares) } else { 0.0 }
}

/// Side of a place, metres: a parked car, a bay, a few posts.
const PLACE_M: f32 = 6.4;

/// The expected position as a candidate: the prior, uncorrected.
const EXPECTED: Candidate = Candidate { correction: Pose2::IDENTITY, score: 0.0, at_edge: false };

/// Matches parts with the map, with the buffers of one thread.
#[derive(Default)]
pub struct PartMatcher {
    pipeline: Pipeline,
}

impl PartMatcher {
    /// Matches a part with the map near its expected position: its own positions and `expected`, metres and
    /// radians about its middle. `None` where the map has nothing at all, or the part too few points.
    ///
    /// `tiles` holds the tiles that were asked for, for the next part.
    pub fn find(
        &mut self,
        part: &UploadPart,
        expected: &Pose2,
        map: &dyn MapSide,
        tiles: &mut BTreeMap<TileId, Option<Arc<TileWeights>>>,
        limits: &MatchingLimits,
    ) -> Option<PartMatch> {
        self.pipeline.thin(&part.points, limits.extent_m);
        if self.pipeline.points().len() < limits.min_points {
            return None;
        }
        let square = MapSquare::around(part.zone, part.middle, limits.extent_m, limits.reach_m);
        let known: Vec<_> = square
            .tiles()
            .filter_map(|id| tiles.entry(id).or_insert_with(|| map.weights(id)).clone())
            .collect();
        if known.is_empty() {
            return None;
        }
        self.pipeline.assemble(square, &known);
        let MapPoint { x_m, y_m } = part.middle;
        let prior = Prior {
            pose: Pose2::new(x_m + expected.x_m, y_m + expected.y_m, expected.yaw_rad),
            sigma_position_m: limits.reach_m,
            sigma_yaw_rad: limits.reach_yaw_rad,
            scale: 1.0,
        };
        let search = Search { sigmas: 1.0, extent_m: limits.extent_m, ..Search::default() };
        // The engine that is asked counts the thinned points only.
        let batch = Batch::default();
        let engine = &Stepped::BEST;
        Some(matched(&self.pipeline.rank(engine, &batch, &prior, &search, Some(EXPECTED)), limits))
    }
}

fn matched(ranking: &Ranking, limits: &MatchingLimits) -> PartMatch {
    let question = &ranking.question;
    let (prior, points, view) = (question.prior, question.thinned, question.view);
    let (best, margin) = chosen(ranking, limits);
    let start = Candidate { correction: best.correction, score: best.score, at_edge: best.at_edge };
    let sharp = refine(&ranking.field.sharpened(), points, prior, &start);
    let background = ranking.background(question.lattice.half_widths().0);
    let covered = |position: MapPoint| {
        view.tile_at(position).is_some_and(|tile| tile.is_near(position, limits.covered_within_m))
    };
    PartMatch {
        error: sharp.correction,
        covariance: sharp.covariance(limits.temperature),
        points: points.len(),
        coverage: ranking.fraction(&prior.corrected(&sharp.correction), covered),
        contrast: if background > 0.0 { best.score / background } else { 0.0 },
        margin,
        at_edge: best.at_edge || question.lattice.is_left_by(&sharp.correction),
        elsewhere: Places::of(ranking, &best, limits),
    }
}

/// The best candidate near the expected position.
fn home<'a>(ranking: &Ranking<'a>, limits: &MatchingLimits) -> Option<&'a RefinedCandidate> {
    let near = |candidate: &&RefinedCandidate| {
        candidate.correction.distance_m(&Pose2::IDENTITY) <= limits.near_m
            && candidate.correction.yaw_rad.abs() <= limits.near_yaw_rad
    };
    ranking.refined.iter().find(near)
}

/// The candidate near the expected position unless another one is better by far, else the best one; and by how
/// many nats it exceeds the best one elsewhere.
fn chosen(ranking: &Ranking, limits: &MatchingLimits) -> (RefinedCandidate, f64) {
    let Some(best) = ranking.refined.first() else { return (RefinedCandidate::NONE, 0.0) };
    let nats = ranking.question.thinned.len() as f64 / limits.score_temperature;
    let here = home(ranking, limits)
        .filter(|home| nats * (best.score - home.score) < limits.min_margin)
        .unwrap_or(best);
    let next = ranking.best_beyond(&here.correction);
    (*here, next.map_or(f64::INFINITY, |next| nats * (here.score - next.score)))
}
