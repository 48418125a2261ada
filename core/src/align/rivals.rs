//! The poses that could be meant instead of the answer, in the search and around it.
//!
//! A caller's sigma is a claim, and the best hill of a search at the wrong place is the largest of many chance
//! hills. So the answer is compared with what lies beyond the search as well: the true pose may lie there, or
//! another one that looks alike. Where it is the truth, the objects in view prefer it to all of these; a chance hill is
//! preferred to none but by chance (see [`super::objects`]).

use super::engine::{Candidate, Engine, EngineWorkspace, Fast, SearchQuestion};
use super::objects::{Objects, Preference};
use super::ranking::Ranking;
use super::{Prior, Search};
use crate::pose::Pose2;

/// How far around the answer is looked, metres along each axis: several pitches of whatever repeats along a
/// street, and what a prior is off by where houses reflect the satellites' signals.
const AROUND_M: f64 = 24.0;
/// Other headings that are looked at, radians to either side.
const AROUND_RAD: f64 = 0.017;
/// Fraction of what the map knows at the answer that it must know at a rival: where the map has hardly been, nothing can
/// be said for or against it.
const LEAST_SHARED: f64 = 0.7;
/// Rivals beyond the search that are compared.
const BEYOND: usize = 6;

/// A pose that could be meant instead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rival {
    /// The pose minus the prior, component by component: metres east and north, radians.
    pub correction: Pose2,
    /// By how much the objects in view prefer the answer.
    pub preference: Preference,
    /// True where it lies outside the search.
    pub beyond: bool,
}

/// Finds rivals, with the buffers that one thread reuses.
#[derive(Default)]
pub struct RivalFinder {
    objects: Objects,
    engine: EngineWorkspace,
    found: Vec<Candidate>,
}

/// What the objects in view say of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Challenge {
    /// The rival that the answer is preferred to the least; `None` without any.
    pub strongest: Option<Rival>,
    /// Fraction of what was seen that lies where the map has been, by its returns.
    pub coverage: f64,
}

impl RivalFinder {
    /// Compares the best of a ranking with all that could be meant instead.
    pub fn challenge(&mut self, ranking: &Ranking) -> Challenge {
        let Some(best) = ranking.refined.first() else { return Challenge::default() };
        let question = &ranking.question;
        let (prior, search, scale) = (question.prior, question.search, question.prior.scale);
        let counts = ranking.counts.iter().copied();
        self.objects.group(question.thinned, counts, search.extent_m);
        let here = prior.corrected(&best.correction);
        self.objects.stand(&ranking.field, &here, scale);
        let coverage = self.objects.coverage();
        let around = Prior {
            pose: here,
            sigma_position_m: AROUND_M / search.sigmas,
            sigma_yaw_rad: AROUND_RAD / search.sigmas,
            scale,
        };
        let glance = Search { candidates: BEYOND, ..*search };
        let wide = SearchQuestion::new(question.view, question.batch, question.thinned, &around, &glance);
        Fast::GLANCE.search(&wide, &mut self.engine, &mut self.found);
        let apart = |correction: &Pose2| best.correction.distance_m(correction) >= search.separation_m;
        let mut strongest: Option<Rival> = None;
        let elsewhere = self.found.iter().map(|other| {
            let Pose2 { x_m, y_m, yaw_rad } = best.correction;
            let by = other.correction;
            Pose2::new(x_m + by.x_m, y_m + by.y_m, yaw_rad + by.yaw_rad)
        });
        for correction in ranking.refined.iter().map(|other| other.correction).chain(elsewhere).filter(apart)
        {
            let other = prior.corrected(&correction);
            let preference = self.objects.preference(&ranking.field, &other, scale);
            if preference.shared < LEAST_SHARED {
                continue;
            }
            if strongest.is_none_or(|so_far| preference.sum < so_far.preference.sum) {
                let beyond = question.lattice.is_left_by(&correction);
                strongest = Some(Rival { correction, preference, beyond });
            }
        }
        Challenge { strongest, coverage }
    }
}
