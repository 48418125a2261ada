//! The verdict on an upload, from its parts together.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::matching::{MatchingLimits, PartMatch, PartMatcher};
use super::part::{UploadPart, parts};
use super::{MapSide, Offsets, TileHits};
use crate::datum::{Datum, Offset, PoseSigma, mean_offset};
use crate::geo::TileId;
use crate::pose::Pose2;

/// When an upload agrees with the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VettingLimits {
    /// Shift beyond which an upload is wrong, metres, from the map less its own offset. That is a mean, which of few
    /// passes errs itself: `sqrt(1 + 1 / passes)` times as much is allowed, and more where what the upload and the map's
    /// passes declare of their poses is worse than what is assumed of those that declare nothing.
    pub shift_m: f64,
    /// The same for the turn, radians.
    pub yaw_rad: f64,
    /// One-sigma error of an honest upload along each axis, metres: the prior by which an offset that the
    /// map does not determine is drawn to zero.
    pub sigma_m: f64,
    /// The same for its heading, radians.
    pub sigma_yaw_rad: f64,
    /// Fraction of a part near which the map must have something, for the part to be matched.
    pub min_coverage: f64,
    /// The same, for the part to be judged wrong.
    pub known_coverage: f64,
    /// Score relative to a random shift's, below which a part matches nowhere, unless where it was expected is distinctly
    /// the best of all that is searched.
    pub min_contrast: f64,
    /// How parts are made and matched.
    pub matching: MatchingLimits,
}

impl Default for VettingLimits {
    fn default() -> Self {
        Self {
            shift_m: 0.45,
            yaw_rad: 1_f64.to_radians(),
            sigma_m: 0.12,
            sigma_yaw_rad: 0.2_f64.to_radians(),
            min_coverage: 0.3,
            known_coverage: 0.9,
            min_contrast: 1.35,
            matching: MatchingLimits::default(),
        }
    }
}

/// Why an upload is quarantined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reason {
    /// It lies beside the map.
    Shifted,
    /// It is turned against the map.
    Rotated,
    /// It shows something else than the map.
    Disagrees,
}

/// The outcome of vetting.
#[derive(Debug, Clone, PartialEq)]
pub enum Vetted {
    /// It agrees; moved by these offsets it lies on the map.
    Agrees(Offsets),
    /// The map has nothing there to compare it with. These offsets are those of its neighbourhood.
    New(Offsets),
    /// It does not agree, and stays out of the map.
    Quarantined {
        /// Why.
        reason: Reason,
        /// The offset that would correct it, where that could be measured.
        offset: Option<Offset>,
    },
}

/// Vets uploads, with the buffers of one thread.
#[derive(Default)]
pub struct Vetter {
    matcher: PartMatcher,
}

/// A part of an upload, and the verdict on it.
#[derive(Debug, Clone)]
pub struct JudgedPart {
    /// The part.
    pub part: UploadPart,
    /// The map's own offset at the part's middle.
    pub expected: Pose2,
    /// How it matches, if the map has anything there.
    pub found: Option<PartMatch>,
    /// The verdict.
    pub verdict: PartVerdict,
}

/// The verdict on a part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PartVerdict {
    /// None: the map knows too little there, or it fits elsewhere and where it was expected as well.
    None,
    /// It matches nowhere.
    Lost,
    /// It matches here.
    Found {
        /// Shift and turn beyond the expected ones, drawn to zero where the map does not determine them.
        error: Pose2,
        /// The same, relative to what is allowed.
        excess: Excess,
    },
}

/// An error relative to what is allowed: up to 1 it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Excess {
    /// Of the shift.
    pub shift: f64,
    /// Of the turn.
    pub turn: f64,
}

impl Excess {
    /// True within both limits.
    #[must_use]
    pub fn is_allowed(&self) -> bool {
        self.shift <= 1.0 && self.turn <= 1.0
    }
}

impl Vetter {
    /// Compares an upload, its cells in one zone, with the map. `declared` is how well its poses are known; `None` for
    /// an upload of before there were declarations, which is judged as it was then.
    pub fn vet(
        &mut self,
        tiles: &[TileHits],
        map: &dyn MapSide,
        limits: &VettingLimits,
        declared: Option<PoseSigma>,
    ) -> Vetted {
        together(&self.judge_parts(tiles, map, limits, declared))
    }

    /// The parts of an upload and the verdict on each: what [`Vetter::vet`] rests on.
    pub fn judge_parts(
        &mut self,
        tiles: &[TileHits],
        map: &dyn MapSide,
        limits: &VettingLimits,
        declared: Option<PoseSigma>,
    ) -> Vec<JudgedPart> {
        let mut prepared = BTreeMap::new();
        let mut judged = Vec::new();
        for part in parts(tiles, limits.matching.extent_m) {
            let id = TileId::of(part.zone, part.middle);
            let expected = mean_offset(part.zone, part.middle, |id| map.datum(id));
            let doubt = Doubt::of(declared, &map.datum(id));
            let matching = doubt.matching(limits);
            let found = self.matcher.find(&part, &expected, map, &mut prepared, &matching);
            let verdict = found.map_or(PartVerdict::None, |found| part_verdict(&found, &doubt, limits));
            judged.push(JudgedPart { part, expected, found, verdict });
        }
        judged
    }
}

/// Standard errors by which the places of a part must agree.
const AGREED: f64 = 3.0;

/// How far an honest upload and the map's mean may differ, relative to an upload that declares nothing beside a mean
/// that does not err.
struct Doubt {
    shift: f64,
    turn: f64,
    /// Judged as uploads were before there were declarations.
    of_before: bool,
}

impl Doubt {
    fn of(declared: Option<PoseSigma>, datum: &Datum) -> Self {
        let assumed = PoseSigma::default();
        let Some(sigma) = declared else {
            let young = (1.0 + 1.0 / f64::from(datum.passes.max(1))).sqrt();
            return Self { shift: young, turn: young, of_before: true };
        };
        let mean = datum.variance();
        let relative = |own: f64, mean: Option<f64>, assumed: f64| {
            ((own * own + mean.unwrap_or(assumed * assumed)) / (assumed * assumed)).sqrt()
        };
        Self {
            shift: relative(sigma.position_m(), mean.map(|v| v.position_m2), assumed.position_m()),
            turn: relative(sigma.yaw_rad(), mean.map(|v| v.yaw_rad2), assumed.yaw_rad()),
            of_before: false,
        }
    }

    /// What is allowed, relative to the limits: a good declaration does not make them stricter.
    fn allowed(&self) -> [f64; 2] {
        [self.shift.max(1.0), self.turn.max(1.0)]
    }

    /// How to match: what is allowed is near.
    fn matching(&self, limits: &VettingLimits) -> MatchingLimits {
        let MatchingLimits { near_m, near_yaw_rad, .. } = limits.matching;
        if self.of_before {
            return limits.matching;
        }
        let [shift, turn] = self.allowed();
        MatchingLimits {
            near_m: near_m.max(limits.shift_m * shift),
            near_yaw_rad: near_yaw_rad.max(limits.yaw_rad * turn),
            ..limits.matching
        }
    }
}

fn part_verdict(at: &PartMatch, doubt: &Doubt, limits: &VettingLimits) -> PartVerdict {
    let sigma =
        [limits.sigma_m * doubt.shift, limits.sigma_m * doubt.shift, limits.sigma_yaw_rad * doubt.turn];
    let error = drawn(&at.error, &at.covariance, sigma);
    let [shift, turn] = doubt.allowed();
    let excess = Excess {
        shift: error.x_m.hypot(error.y_m) / limits.shift_m / shift,
        turn: error.yaw_rad.abs() / limits.yaw_rad / turn,
    };
    let held = at.covariance.iter().all(|v| v.is_finite());
    // Where much clutter was mapped, a random shift scores high, too, and the contrast says little. But of all that is
    // searched, by chance the distinctly best hardly ever lies where it was expected.
    let at_home = !doubt.of_before && excess.is_allowed() && at.margin >= limits.matching.min_margin;
    let matches = at.contrast >= limits.min_contrast || at_home;
    let fits = held && matches;
    let here = PartVerdict::Found { error, excess };
    let known = at.coverage >= limits.known_coverage;
    if excess.is_allowed() {
        return match (fits, known) {
            (true, _) if at.coverage >= limits.min_coverage => here,
            (false, true) if !matches => PartVerdict::Lost,
            _ => PartVerdict::None,
        };
    }
    // It matches elsewhere than expected: that means something only where the map is known.
    let clear = fits && !at.at_edge && at.margin >= limits.matching.min_margin;
    // Where a street repeats itself it fits a pitch away as well: then it is neither moved nor kept out.
    let places = at.elsewhere.filter(|_| !doubt.of_before);
    let agreed = places.is_none_or(|places| places.clear >= AGREED);
    let fits_here_too = places.is_some_and(|places| places.at_home >= AGREED);
    match (known, clear && agreed) {
        (false, _) => PartVerdict::None,
        (true, true) => here,
        (true, false) if fits_here_too => PartVerdict::None,
        (true, false) => PartVerdict::Lost,
    }
}

/// A measurement, drawn to zero as far as its errors exceed those that are expected.
fn drawn(measured: &Pose2, covariance: &Matrix3<f64>, sigma: [f64; 3]) -> Pose2 {
    let expected = Matrix3::from_diagonal(&Vector3::from(sigma.map(|s| s * s)));
    let gain = (expected + covariance).try_inverse().map(|inverse| expected * inverse);
    let Some(gain) = gain.filter(|g| g.iter().all(|v| v.is_finite())) else { return Pose2::IDENTITY };
    let [x, y, yaw]: [f64; 3] = (gain * Vector3::new(measured.x_m, measured.y_m, measured.yaw_rad)).into();
    Pose2::new(x, y, yaw)
}

/// The parts together, each weighted by its points.
fn together(judged: &[JudgedPart]) -> Vetted {
    let (mut agree, mut lost, mut wrong) = (0, 0, [0, 0]);
    let mut errors = Vec::new();
    for JudgedPart { found, verdict, .. } in judged {
        let Some(PartMatch { points, error, .. }) = found else { continue };
        match verdict {
            PartVerdict::None => {}
            PartVerdict::Lost => lost += points,
            PartVerdict::Found { excess, .. } if excess.is_allowed() => agree += points,
            PartVerdict::Found { excess, .. } => {
                wrong[usize::from(excess.turn > 1.0)] += points;
                errors.push((*error, *points));
            }
        }
    }
    let [shifted, turned] = wrong;
    if agree > 0 && agree >= lost + shifted + turned {
        return Vetted::Agrees(offsets(judged));
    }
    if lost + shifted + turned == 0 {
        return Vetted::New(offsets(judged));
    }
    if lost > shifted + turned {
        return Vetted::Quarantined { reason: Reason::Disagrees, offset: None };
    }
    let reason = if turned >= shifted { Reason::Rotated } else { Reason::Shifted };
    Vetted::Quarantined { reason, offset: heaviest(&errors).map(|error| Offset::of(&error)) }
}

/// The offsets that move the parts that agree onto the map; if none does, the expected ones.
fn offsets(judged: &[JudgedPart]) -> Offsets {
    let mut offsets = Offsets::default();
    for JudgedPart { part, expected, found, verdict } in judged {
        let (PartVerdict::Found { error, excess }, Some(at)) = (verdict, found) else { continue };
        if excess.is_allowed() {
            let onto_map = sum(expected, error);
            let spread = at.covariance[(0, 0)] + at.covariance[(1, 1)];
            offsets.push(part.middle, Offset::of(&onto_map), 1.0 / (spread + FLOOR_M * FLOOR_M));
        }
    }
    if offsets.is_empty() {
        for JudgedPart { part, expected, .. } in judged {
            offsets.push(part.middle, Offset::of(expected), 1.0);
        }
    }
    offsets
}

/// The least uncertainty of a part's offset, metres.
const FLOOR_M: f64 = 0.05;

fn sum(a: &Pose2, b: &Pose2) -> Pose2 {
    Pose2::new(a.x_m + b.x_m, a.y_m + b.y_m, a.yaw_rad + b.yaw_rad)
}

/// The error of the part with most points.
fn heaviest(errors: &[(Pose2, usize)]) -> Option<Pose2> {
    errors.iter().max_by_key(|(_, points)| *points).map(|(error, _)| *error)
}

#[cfg(test)]
mod tests;
