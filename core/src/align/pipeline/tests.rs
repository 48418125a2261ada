//! A field of posts, seen from its middle, and an engine that returns given candidates.

use super::*;
use crate::geo::Zone;
use crate::once::tiles_of;
use crate::point::MapPoint;
use crate::pose::Pose2;

const MIDDLE: MapPoint = MapPoint::new(600_010.0, 3_300_020.0);
const REACH_M: f64 = 10.0;

/// Offsets of posts from the middle: the R2 sequence, which has no pattern a search could lock to.
fn posts() -> Vec<BodyPoint> {
    let along = |i: i32, step: f32| 16.0 * ((0.5 + step * i as f32).fract() - 0.5);
    (0..300).map(|i| BodyPoint::new(along(i, 0.754_877_7), along(i, 0.569_840_3))).collect()
}

/// Returns these corrections as candidates.
struct Given<'a>(&'a [Pose2]);

impl Engine for Given<'_> {
    fn name(&self) -> &'static str {
        "given"
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        _: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        for (_, candidates) in questions.iter().zip(candidates) {
            candidates.clear();
            candidates.extend(self.0.iter().copied().map(candidate));
        }
    }
}

fn candidate(correction: Pose2) -> Candidate {
    Candidate { correction, score: 0.0, at_edge: false }
}

/// A pipeline whose map and points are ready, around a prior that is right.
fn ready() -> (Pipeline, Prior, Search) {
    let zone = Zone::from_epsg(32614).expect("a zone of UTM");
    let on_map: Vec<_> = posts().iter().map(|p| MIDDLE.moved(f64::from(p.x_m), f64::from(p.y_m))).collect();
    let tiles = tiles_of(zone, &on_map, MIDDLE, 100.0).expect("posts have positions");
    let weights: Vec<_> =
        tiles.keys().map(|id| Arc::new(TileWeights::new(*id, |at| tiles.get(&at)))).collect();
    let pose = Pose2::new(MIDDLE.x_m, MIDDLE.y_m, 0.0);
    let prior = Prior { pose, sigma_position_m: 1.0, sigma_yaw_rad: 0.02, scale: 1.0 };
    let search = Search { extent_m: REACH_M, ..Search::default() };
    let mut pipeline = Pipeline::default();
    pipeline.assemble(MapSquare::around(zone, MIDDLE, REACH_M, 3.0), &weights);
    pipeline.thin(&posts(), REACH_M);
    (pipeline, prior, search)
}

/// Catches a threshold that refines everything or the expected candidate never: vetting would take the
/// position that an upload claims for the one that the map shows.
#[test]
fn what_cannot_be_the_best_is_not_refined_unless_it_is_expected() {
    let (mut pipeline, prior, search) = ready();
    let (near, far) = (Pose2::new(0.1, 0.0, 0.0), Pose2::new(2.0, 1.0, 0.0));
    let batch = Batch::default();
    let refined = |ranking: &Ranking| {
        let refined =
            |r: &RefinedCandidate| (r.correction.distance_m(&far) < 1.0, r.information.norm() > 0.0);
        ranking.refined.iter().map(refined).collect::<Vec<_>>()
    };
    let engines = pipeline.rank(&Given(&[far, near]), &batch, &prior, &search, None);
    assert_eq!(refined(&engines), [(false, true), (true, false)], "the better one first");
    assert!(engines.refined[0].correction.distance_m(&Pose2::IDENTITY) < 0.05);
    let expected = pipeline.rank(&Given(&[near]), &batch, &prior, &search, Some(candidate(far)));
    assert_eq!(refined(&expected), [(false, true), (true, true)]);
}

/// Catches a background that is taken at the answer, a fraction of all points that is taken of the sample, and a
/// best candidate elsewhere that is the answer itself.
#[test]
fn a_ranking_answers_what_verdicts_rest_on() {
    let (mut pipeline, prior, search) = ready();
    let batch = Batch::default();
    let far = Pose2::new(2.0, 1.0, 0.0);
    let ranking = pipeline.rank(&Given(&[Pose2::IDENTITY, far]), &batch, &prior, &search, None);
    let best = ranking.refined[0];
    let elsewhere = ranking.best_beyond(&best.correction).expect("there are two");
    assert!(elsewhere.correction.distance_m(&far) < 1.0 && elsewhere.score < best.score);
    let background = ranking.background(3.0);
    assert!(background > 0.0 && 1.5 * background < best.score, "{background} {best:?}");
    let west = ranking.fraction(&prior.pose, |point| point.x_m < MIDDLE.x_m);
    assert!((0.4..0.6).contains(&west), "{west}");
    assert!((ranking.fraction(&prior.pose, |_| true) - 1.0).abs() < 1e-12);
    let covariance = best.covariance(2.0);
    assert!((1e-6..1e-2).contains(&covariance[(0, 0)]), "{covariance}");
    assert!(elsewhere.covariance(2.0)[(0, 0)].is_infinite(), "it was not refined");
}

/// Catches points that stay from the last request.
#[test]
fn points_are_replaced() {
    let (mut pipeline, ..) = ready();
    let one = WeightedPoint::new(1.0, 2.0, 1.0);
    pipeline.set_points([one]);
    assert_eq!(pipeline.points(), [one]);
    pipeline.thin(&[0.0, 0.01, 50.0].map(|x| BodyPoint::new(x, 0.0)), REACH_M);
    assert_eq!(pipeline.points().len(), 1);
}
