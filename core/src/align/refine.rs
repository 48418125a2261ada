//! Refining a candidate: to the maximum of the smooth score, below a cell and below a heading step.

use nalgebra::Matrix3;

use super::Prior;
use super::engine::Candidate;
use super::score::{ScoreField, Slope};
use crate::point::WeightedPoint;
use crate::pose::{Pose2, wrap_angle};

/// Lengths that one step may have at most: metres, metres, radians.
pub(super) const MAX_STEP: [f64; 3] = [0.3, 0.3, 0.015];
/// A step below this is the last one: metres, metres, radians.
const CONVERGED: [f64; 3] = [0.003, 0.003, 0.000_1];
/// Points that are enough for most of the way.
const GUIDES: usize = 640;
pub(super) const MAX_STEPS: usize = 8;
/// Parts of a step that are tried, until one raises the score.
pub(super) const STEP_PARTS: [f64; 3] = [1.0, 0.5, 0.25];

/// A candidate, moved to the maximum of the smooth score.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedCandidate {
    /// Corrected pose minus prior: metres east and north, radians.
    pub correction: Pose2,
    /// Mean weight of the points there.
    pub score: f64,
    /// Negative second derivatives of the summed score over (east m, north m, yaw rad); the drift,
    /// if it was estimated, is marginalised out.
    pub information: Matrix3<f64>,
    /// Covariance of the same that the score does not know, square metres and radians.
    pub beyond: Matrix3<f64>,
    /// True when the candidate lay on the edge of the search.
    pub at_edge: bool,
}

impl RefinedCandidate {
    /// Without any candidate: the prior itself, of which nothing is known.
    pub const NONE: Self = Self {
        correction: Pose2::IDENTITY,
        score: 0.0,
        information: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        beyond: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        at_edge: false,
    };

    /// The candidate where the engine found it, with its smooth score and without information.
    #[must_use]
    pub fn unrefined(
        field: &ScoreField,
        points: &[WeightedPoint],
        prior: &Prior,
        candidate: &Candidate,
    ) -> Self {
        let pose = prior.corrected(&candidate.correction);
        let score = field.slope(points, &pose, prior.scale).value / points.len().max(1) as f64;
        let Candidate { correction, at_edge, .. } = *candidate;
        Self { correction, score, at_edge, ..Self::NONE }
    }

    /// Covariance of (east m, north m, yaw rad): the inverse information times a temperature, and what lies beyond it;
    /// infinite where
    /// the points do not determine the pose.
    #[must_use]
    pub fn covariance(&self, temperature: f64) -> Matrix3<f64> {
        let inverse = self.information.cholesky().map(|c| c.inverse() * temperature);
        inverse
            .filter(|c| c.iter().all(|v| v.is_finite()))
            .map_or_else(|| Matrix3::from_diagonal_element(f64::INFINITY), |c| c + self.beyond)
    }
}

/// Refines a candidate with rigid points: most of the way with a part of them, for that takes less time.
#[must_use]
pub fn refine(
    field: &ScoreField,
    points: &[WeightedPoint],
    prior: &Prior,
    candidate: &Candidate,
) -> RefinedCandidate {
    let start = [candidate.correction.x_m, candidate.correction.y_m, candidate.correction.yaw_rad];
    let mut some = [WeightedPoint::new(0.0, 0.0, 0.0); GUIDES];
    let count = points.len().min(GUIDES);
    for (i, guide) in some[..count].iter_mut().enumerate() {
        *guide = points[i * points.len() / count];
    }
    let (near, _) = ascend(field, &some[..count], prior, start);
    let (at, here) = ascend(field, points, prior, near);
    RefinedCandidate {
        correction: Pose2::new(at[0], at[1], wrap_angle(at[2])),
        score: here.value / points.len().max(1) as f64,
        information: -curvature(&here),
        beyond: Matrix3::zeros(),
        at_edge: candidate.at_edge,
    }
}

fn ascend(field: &ScoreField, points: &[WeightedPoint], prior: &Prior, from: [f64; 3]) -> ([f64; 3], Slope) {
    let slope_at =
        |[x, y, yaw]: [f64; 3]| field.slope(points, &prior.corrected(&Pose2::new(x, y, yaw)), prior.scale);
    let (mut at, mut here) = (from, slope_at(from));
    for _ in 0..MAX_STEPS {
        let step = bounded(ascent(&here));
        // A step this small changes nothing: the score there need not be computed.
        if small(step) {
            break;
        }
        let Some((next, slope)) = uphill(at, here.value, step, slope_at) else { break };
        (at, here) = (next, slope);
    }
    (at, here)
}

pub(super) fn curvature(slope: &Slope) -> Matrix3<f64> {
    let [xx, xy, yy, xt, yt, tt] = slope.curvature;
    Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt)
}

/// Newton's step where the score curves down in every direction, else one along the slope.
fn ascent(slope: &Slope) -> [f64; 3] {
    let gradient = nalgebra::Vector3::from(slope.gradient);
    if let Some(cholesky) = (-curvature(slope)).cholesky() {
        return cholesky.solve(&gradient).into();
    }
    // As long as half the longest step, in the metric of the longest steps.
    let scaled = [0, 1, 2].map(|i: usize| slope.gradient[i] * MAX_STEP[i]);
    let norm = scaled.iter().map(|v| v * v).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    [0, 1, 2].map(|i: usize| 0.5 * MAX_STEP[i] * scaled[i] / norm)
}

fn bounded(step: [f64; 3]) -> [f64; 3] {
    let excess = step.iter().zip(MAX_STEP).map(|(s, most)| (s / most).abs()).fold(1.0, f64::max);
    step.map(|s| s / excess)
}

pub(super) fn small(step: [f64; 3]) -> bool {
    step.iter().zip(CONVERGED).all(|(s, limit)| s.abs() < limit)
}

/// The first of the step, its half and its quarter that raises the score.
fn uphill(
    at: [f64; 3],
    value: f64,
    step: [f64; 3],
    slope_at: impl Fn([f64; 3]) -> Slope,
) -> Option<([f64; 3], Slope)> {
    STEP_PARTS.into_iter().find_map(|part| {
        let next = [0, 1, 2].map(|i: usize| at[i] + part * step[i]);
        let slope = slope_at(next);
        (slope.value > value).then_some((next, slope))
    })
}
