//! The answer: what the pipeline found, corrected, with its errors, its diagnostics and its verdict.

use nalgebra::Matrix3;

use super::alternatives::Alternatives;
use super::ranking::Ranking;
use super::refine::RefinedCandidate;
use super::rivals::{Challenge, Rival};
use super::verdict::{Integrity, Protection, Verdict, verdict};
use crate::point::MapPoint;
use crate::pose::{Pose2, wrap_angle};

/// The answer with its diagnostics.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// Corrected pose of the body: map metres, radians from grid east.
    pub pose: Pose2,
    /// Corrected pose minus prior, component by component: metres east and north, radians.
    pub correction: Pose2,
    /// Covariance of (east m, north m, yaw rad).
    pub covariance: [[f64; 3]; 3],
    /// Other poses that explain the batch.
    pub alternatives: Alternatives,
    /// Mean weight of the batch's points, less that of a random shift.
    pub score: f64,
    /// The answer's mean weight relative to that of a random shift.
    pub contrast: f64,
    /// How clearly the objects in view prefer the answer to its strongest rival, in the search or around it, nats:
    /// see [`Preference::nats`](super::objects::Preference::nats). 0 without a rival: then nothing can be said.
    pub margin: f64,
    /// That rival.
    pub rival: Option<Rival>,
    /// By how much the prior is surprised by the answer, nats: see [`Search::surprise`](super::Search::surprise).
    pub surprise: f64,
    /// Detections that were used.
    pub points_used: usize,
    /// Points that the batch was thinned to.
    pub thinned_points: usize,
    /// Fraction of them that lie on mapped structure at the answer.
    pub matched_fraction: f64,
    /// Fraction of what was seen that lies where the map has been, by its returns.
    pub coverage: f64,
    /// Half width of the search: metres and radians.
    pub searched: (f64, f64),
    /// May it be used?
    pub verdict: Verdict,
}

impl Alignment {
    /// Protection levels for an integrity risk in (0, 1).
    #[must_use]
    pub fn protection(&self, integrity: &Integrity, risk: f64) -> Protection {
        // P(|x| > k sigma) <= exp(-k^2 / 2) for a Gaussian.
        let k = integrity.tail * (-2.0 * risk.ln()).sqrt();
        let (s, c) = self.pose.yaw_rad.sin_cos();
        let [[xx, xy, _], [_, yy, _], [_, _, tt]] = self.covariance;
        let along = c * c * xx + 2.0 * c * s * xy + s * s * yy;
        let cross = s * s * xx - 2.0 * c * s * xy + c * c * yy;
        Protection { along_m: k * along.sqrt(), cross_m: k * cross.sqrt(), yaw_rad: k * tt.sqrt() }
    }
}

/// What an answer is judged by.
pub(super) struct Findings<'a> {
    /// The refined candidates of the rigid batch; the best of them is the answer's.
    pub ranking: &'a Ranking<'a>,
    /// The answer, if there is any candidate.
    pub answer: Option<RefinedCandidate>,
    /// What the objects in view say of it.
    pub challenge: Challenge,
}

impl Findings<'_> {
    /// The answer with its verdict.
    pub(super) fn judge(&self, integrity: &Integrity) -> Alignment {
        let question = &self.ranking.question;
        let reach_sq = (question.search.extent_m * question.search.extent_m) as f32;
        let best = self.answer.unwrap_or(RefinedCandidate::NONE);
        let rigid = self.ranking.refined.first().unwrap_or(&RefinedCandidate::NONE);
        let on_map = question.prior.corrected(&best.correction);
        let searched = question.lattice.half_widths();
        let background = self.ranking.background(searched.0.max(1.0));
        let matched_fraction = self.matched_fraction(&on_map, integrity);
        // The map's own offset here is taken back from the answer.
        let off = question.view.mean_offset(MapPoint::of(&on_map));
        let truer =
            |c: &Pose2| Pose2::new(c.x_m - off.x_m, c.y_m - off.y_m, wrap_angle(c.yaw_rad - off.yaw_rad));
        let mut alignment = Alignment {
            pose: truer(&on_map),
            correction: truer(&best.correction),
            covariance: self.covariance(&best, integrity).into(),
            alternatives: self.alternatives(background, truer),
            score: rigid.score - background,
            contrast: rigid.score / background.max(f64::MIN_POSITIVE),
            margin: self.challenge.strongest.map_or(0.0, |rival| rival.preference.nats()),
            rival: self
                .challenge
                .strongest
                .map(|rival| Rival { correction: truer(&rival.correction), ..rival }),
            surprise: question.search.surprise(question.prior, &best.correction),
            points_used: question.batch.points.iter().filter(|p| p.squared_range() <= reach_sq).count(),
            thinned_points: question.thinned.len(),
            matched_fraction,
            coverage: self.challenge.coverage,
            searched,
            verdict: Verdict::Usable,
        };
        let at_edge = best.at_edge || question.lattice.is_left_by(&best.correction);
        alignment.verdict = verdict(&alignment, at_edge, integrity);
        alignment
    }

    /// The fraction of the batch that lies on mapped structure.
    fn matched_fraction(&self, pose: &Pose2, integrity: &Integrity) -> f64 {
        let view = self.ranking.question.view;
        let matched = |position: MapPoint| {
            view.tile_at(position).is_some_and(|tile| tile.is_near(position, integrity.matched_within_m))
        };
        self.ranking.fraction(pose, matched)
    }

    /// Candidates elsewhere, by their score above the background.
    fn alternatives(&self, background: f64, truer: impl Fn(&Pose2) -> Pose2) -> Alternatives {
        let mut others = Alternatives::default();
        let apart_m = self.ranking.question.search.separation_m;
        let Some((best, rest)) = self.ranking.refined.split_first() else { return others };
        for other in rest {
            let correction = truer(&other.correction);
            let apart = |pose: &Pose2| pose.distance_m(&correction) >= apart_m;
            if best.correction.distance_m(&other.correction) >= apart_m
                && others.iter().all(|(pose, _)| apart(pose))
            {
                // Everything is an alternative to an answer that is no better than a random shift.
                let above = best.score - background;
                let relative = if above > 0.0 { (other.score - background) / above } else { 1.0 };
                others.push(correction, relative.clamp(0.0, 1.0));
            }
        }
        others
    }

    /// The candidate's own covariance, and what no number of returns can reduce: the map's own error.
    fn covariance(&self, best: &RefinedCandidate, integrity: &Integrity) -> Matrix3<f64> {
        let mut covariance = best.covariance(integrity.temperature);
        let on_map = self.ranking.question.prior.corrected(&best.correction);
        let map = integrity.map_variance(&self.ranking.map_error(&on_map, integrity.map_pose_m));
        for (axis, variance) in map.into_iter().enumerate() {
            covariance[(axis, axis)] += variance;
        }
        let own = &self.ranking.question.batch.own_error.0;
        covariance + Matrix3::from(super::combine::turned(own, on_map.yaw_rad))
    }
}
