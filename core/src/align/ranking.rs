//! Refined candidates in order, and the questions that are asked of them.

use super::engine::SearchQuestion;
use super::refine::RefinedCandidate;
use super::score::ScoreField;
use crate::datum::MapVariance;
use crate::point::{MapPoint, WeightedPoint};
use crate::pose::Pose2;

/// Points that fractions and backgrounds are counted on: of 256 a fraction has a standard error of 3 %.
const SAMPLE: usize = 256;
/// Steps of the background's lattice on either side.
const BACKGROUND_STEPS: i32 = 2;

/// What the pipeline found.
pub struct Ranking<'a> {
    /// What was asked.
    pub question: SearchQuestion<'a>,
    /// Detections that each of the question's thinned points was made of.
    pub counts: &'a [f32],
    /// What the candidates were refined on.
    pub field: ScoreField<'a>,
    /// Best first; those that could not be the best are as the engine found them.
    pub refined: &'a [RefinedCandidate],
}

impl Ranking<'_> {
    /// The best one that lies at least the search's separation from a correction.
    #[must_use]
    pub fn best_beyond(&self, correction: &Pose2) -> Option<&RefinedCandidate> {
        let apart_m = self.question.search.separation_m;
        self.refined.iter().find(|other| other.correction.distance_m(correction) >= apart_m)
    }

    /// The score at a random shift: the mean over a lattice of so many metres in each direction.
    #[must_use]
    pub fn background(&self, half_m: f64) -> f64 {
        let prior = self.question.prior;
        let step = half_m / f64::from(BACKGROUND_STEPS);
        let steps = || (-BACKGROUND_STEPS..=BACKGROUND_STEPS).map(|i| f64::from(i) * step);
        let (mut sum, mut count) = (0.0, 0.0);
        for pose in steps().flat_map(|x| steps().map(move |y| prior.corrected(&Pose2::new(x, y, 0.0)))) {
            sum += self.field.value(self.sample(), &pose, prior.scale);
            count += self.sample().len() as f64;
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }

    /// The fraction of the points that pass a test of where they lie on the map, seen by a body at a pose; 0
    /// without points.
    pub fn fraction(&self, pose: &Pose2, passes: impl Fn(MapPoint) -> bool) -> f64 {
        let scale = self.question.prior.scale;
        let on_map = |point: &WeightedPoint| pose.to_map(point.position(), scale);
        let passed = self.sample().filter(|point| passes(on_map(point))).count();
        if passed > 0 { passed as f64 / self.sample().len() as f64 } else { 0.0 }
    }

    /// How far the map may err as a whole under the points, seen by a body at a pose; see [`super::view::MapView::map_error`].
    #[must_use]
    pub fn map_error(&self, pose: &Pose2, pose_m: f64) -> MapVariance {
        let scale = self.question.prior.scale;
        let on_map = |point: &WeightedPoint| pose.to_map(point.position(), scale);
        self.question.view.map_error(self.sample().map(on_map), pose_m)
    }

    fn sample(&self) -> impl ExactSizeIterator<Item = &WeightedPoint> {
        let points = self.question.thinned;
        points.iter().step_by(points.len() / SAMPLE + 1)
    }
}
