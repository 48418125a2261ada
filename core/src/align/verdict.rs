//! May the answer be used, and how large can its error be?
//!
//! No threshold here depends on what a radar, a street or a map are like. An answer may be used when the objects in
//! view prefer it to every other pose that could be meant ([`super::rivals`]), when they determine it in every
//! direction, and when the map has been where most of them stand. Whatever else is known of the answer only says
//! why it may not be used.

use super::Alignment;
use crate::datum::MapVariance;
use crate::pose::Pose2;

/// What an answer must pass, and the calibration of its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Integrity {
    /// Points a thinned batch must have: fewer have no covariance worth the name.
    pub min_points: usize,
    /// Fraction of what was seen that must lie where the map has been.
    pub min_coverage: f64,
    /// How clearly the objects in view must prefer the answer to any other pose, nats: see
    /// [`super::objects::Preference::nats`]; and beyond that as much as the prior is surprised by the answer
    /// ([`Alignment::surprise`]).
    pub min_margin: f64,
    /// A detection lies on mapped structure when a map point is this near, metres.
    pub matched_within_m: f64,
    /// Score of an answer relative to that of a random pose, below which an answer that may not be used is said to
    /// be lost: it is no better than one.
    pub lost_below: f64,
    /// Score of the best alternative relative to the answer's, below which an answer that objects contradict is
    /// said to be one on a stale map: there is no other.
    pub alone_below: f64,
    /// Largest sigma of the answer along any direction, metres.
    pub max_sigma_m: f64,
    /// Independent returns count for this many points of a thinned batch: for the curvature of the score, on squared
    /// weights.
    pub temperature: f64,
    /// Error of the poses that a pass was mapped from, where a tile knows nothing of its passes: one sigma along each
    /// axis, metres. Elsewhere the tiles know it ([`crate::datum::Datum::variance`]).
    pub map_pose_m: f64,
    /// Error of the map that no number of passes averages out: one sigma along each axis, metres.
    pub floor_m: f64,
    /// Error of the map's heading: one sigma, radians.
    pub floor_yaw_rad: f64,
    /// Factor on the protection levels that covers the heavier-than-Gaussian tail.
    pub tail: f64,
}

/// How much of the heading's error of the poses becomes the heading's error of the map. A turned pose shifts what lies ahead
/// to one side and what lies beside forwards; while the vehicle passes by, the first averages out, and what is left is
/// half a turn at most. Realised on surveys of 0.1 to 0.4 degrees (`cargo test -p echofix-sim --test crowd -- --ignored
/// honest_contributors --nocapture`, towns 301 and 302).
const YAW_SHARE: f64 = 0.4;

impl Default for Integrity {
    fn default() -> Self {
        Self {
            min_points: 40,
            min_coverage: 0.5,
            min_margin: 2.0,
            matched_within_m: 0.3,
            lost_below: 1.3,
            alone_below: 0.7,
            max_sigma_m: 0.5,
            temperature: 2.0,
            map_pose_m: 0.08,
            floor_m: 0.04,
            floor_yaw_rad: 0.05_f64.to_radians(),
            tail: 1.3,
        }
    }
}

impl Integrity {
    /// Variances of the map's own error (east m2, north m2, yaw rad2): what its tiles know of it, and the floors.
    #[must_use]
    pub fn map_variance(&self, tiles: &MapVariance) -> [f64; 3] {
        let position = tiles.position_m2 + self.floor_m.powi(2);
        let yaw = YAW_SHARE.powi(2) * tiles.yaw_rad2 + self.floor_yaw_rad.powi(2);
        [position, position, yaw]
    }
}

/// May the answer be used? Anything but [`Verdict::Usable`] means no.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// Passed every check.
    Usable,
    /// A second pose explains the objects in view nearly as well.
    Ambiguous {
        /// How clearly they prefer the answer, nats.
        margin: f64,
        /// True when the two lie along the vehicle's heading: the street repeats itself.
        along_track: bool,
    },
    /// The batch determines the pose too little.
    TooLittleStructure {
        /// Its points, thinned.
        points: usize,
        /// Sigma of the answer in its worst direction, metres; infinite where nothing determines it.
        sigma_m: f64,
    },
    /// No other pose comes near, but too many of the objects in view contradict it: the street has changed.
    MapStale {
        /// The fraction of the batch that is on mapped structure.
        matched_fraction: f64,
    },
    /// The best pose lies on the edge of the search, or the objects in view prefer one beyond it, or they prefer the answer
    /// to every other pose, but less clearly than the prior expects something else: the prior is wrong by more than its
    /// sigmas allow, or the answer is a chance hill far from it.
    PriorOutsideSearch,
    /// The map covers too little of what the batch saw.
    TooLittleMap {
        /// The fraction it covers.
        coverage: f64,
    },
    /// No pose explains the batch: it is somewhere else.
    Lost {
        /// Score of the best pose relative to a random one's.
        contrast: f64,
    },
}

/// Bounds of the error along and across the vehicle's heading (metres) and of the heading itself
/// (radians), for an integrity risk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Protection {
    /// Along the heading, metres.
    pub along_m: f64,
    /// Across it, metres.
    pub cross_m: f64,
    /// Radians.
    pub yaw_rad: f64,
}

impl Protection {
    /// The larger of the two horizontal levels' joint bound, metres.
    #[must_use]
    pub fn horizontal_m(&self) -> f64 {
        self.along_m.hypot(self.cross_m)
    }
}

/// The first check that the answer does not pass.
pub(super) fn verdict(answer: &Alignment, at_edge: bool, integrity: &Integrity) -> Verdict {
    let sigma_m = worst_sigma_m(&answer.covariance);
    let Alignment { thinned_points: points, coverage, contrast, margin, .. } = *answer;
    let contested = margin < integrity.min_margin + answer.surprise;
    // Were it nearer to the prior, the answer would pass: not a rival speaks against it, but the prior.
    let unexpected = contested && margin >= integrity.min_margin;
    let displaced = margin < 0.0 && answer.rival.is_some_and(|rival| rival.beyond);
    if points < integrity.min_points {
        Verdict::TooLittleStructure { points, sigma_m }
    } else if coverage < integrity.min_coverage {
        Verdict::TooLittleMap { coverage }
    } else if contested && contrast < integrity.lost_below {
        Verdict::Lost { contrast }
    } else if at_edge || displaced || unexpected {
        Verdict::PriorOutsideSearch
    } else if contested {
        contested_verdict(answer, integrity)
    } else if sigma_m > integrity.max_sigma_m || !sigma_m.is_finite() {
        Verdict::TooLittleStructure { points, sigma_m }
    } else {
        Verdict::Usable
    }
}

/// Why the objects in view do not prefer the answer: because another one is as good, or because they contradict it.
fn contested_verdict(answer: &Alignment, integrity: &Integrity) -> Verdict {
    let relative_score = answer.alternatives.first().map_or(0.0, |(_, relative_score)| *relative_score);
    let in_search = answer.rival.filter(|rival| !rival.beyond);
    if relative_score < integrity.alone_below && in_search.is_none() {
        return Verdict::MapStale { matched_fraction: answer.matched_fraction };
    }
    let along_track = answer.rival.is_some_and(|rival| lies_along(answer, &rival.correction));
    Verdict::Ambiguous { margin: answer.margin, along_track }
}

/// True when another correction lies within 30 degrees of the vehicle's heading from the answer.
fn lies_along(answer: &Alignment, other: &Pose2) -> bool {
    let (dx, dy) = (other.x_m - answer.correction.x_m, other.y_m - answer.correction.y_m);
    let (s, c) = answer.pose.yaw_rad.sin_cos();
    (c * dx + s * dy).abs() > 0.866 * dx.hypot(dy)
}

/// Square root of the larger eigenvalue of the position's covariance, metres.
fn worst_sigma_m(covariance: &[[f64; 3]; 3]) -> f64 {
    let [[xx, xy, _], [_, yy, _], _] = *covariance;
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    if mean.is_finite() { (mean + half.hypot(xy)).sqrt() } else { f64::INFINITY }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::align::Alternatives;
    use crate::align::objects::Preference;
    use crate::align::rivals::Rival;

    fn other(x_m: f64, y_m: f64, relative_score: f64) -> Alternatives {
        let mut others = Alternatives::default();
        others.push(Pose2::new(x_m, y_m, 0.0), relative_score);
        others
    }

    fn rival(x_m: f64, y_m: f64, beyond: bool) -> Rival {
        Rival { correction: Pose2::new(x_m, y_m, 0.0), preference: Preference::default(), beyond }
    }

    pub(in crate::align) fn answer() -> Alignment {
        Alignment {
            pose: Pose2::IDENTITY,
            correction: Pose2::IDENTITY,
            covariance: [[0.04, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 1e-6]],
            alternatives: other(5.0, 0.0, 0.3),
            score: 1.0,
            contrast: 3.0,
            margin: 20.0,
            rival: Some(rival(5.0, 0.0, false)),
            surprise: 0.0,
            points_used: 7000,
            thinned_points: 2000,
            matched_fraction: 0.9,
            coverage: 1.0,
            searched: (6.0, 0.16),
            verdict: Verdict::Usable,
        }
    }

    #[test]
    fn every_check_has_its_own_verdict() {
        let checks = Integrity::default();
        let judged = |change: fn(&mut Alignment)| {
            let mut a = answer();
            change(&mut a);
            verdict(&a, false, &checks)
        };
        assert_eq!(judged(|_| ()), Verdict::Usable);
        assert_eq!(verdict(&answer(), true, &checks), Verdict::PriorOutsideSearch);
        assert!(matches!(judged(|a| a.thinned_points = 10), Verdict::TooLittleStructure { points: 10, .. }));
        assert!(matches!(judged(|a| a.coverage = 0.1), Verdict::TooLittleMap { .. }));
        let lost = judged(|a| (a.contrast, a.margin) = (1.0, 1.0));
        assert!(matches!(lost, Verdict::Lost { .. }), "{lost:?}");
        assert!(matches!(judged(|a| a.margin = 1.0), Verdict::Ambiguous { along_track: true, .. }));
        let aside = judged(|a| (a.margin, a.rival) = (1.0, Some(rival(0.0, 5.0, false))));
        assert!(matches!(aside, Verdict::Ambiguous { along_track: false, .. }), "{aside:?}");
        assert_eq!(judged(|a| (a.margin, a.surprise) = (6.0, 5.0)), Verdict::PriorOutsideSearch);
        assert!(matches!(judged(|a| (a.margin, a.surprise) = (1.9, 5.0)), Verdict::Ambiguous { .. }));
        assert_eq!(judged(|a| (a.margin, a.surprise) = (7.1, 5.0)), Verdict::Usable);
        let displaced = judged(|a| (a.margin, a.rival) = (-1.0, Some(rival(15.0, 0.0, true))));
        assert_eq!(displaced, Verdict::PriorOutsideSearch);
        let contradicted = judged(|a| (a.margin, a.rival) = (1.0, Some(rival(15.0, 0.0, true))));
        assert!(matches!(contradicted, Verdict::MapStale { .. }), "{contradicted:?}");
        assert!(matches!(judged(|a| a.covariance[0][0] = 4.0), Verdict::TooLittleStructure { .. }));
        let unheld = judged(|a| a.covariance[0][0] = f64::INFINITY);
        assert!(matches!(unheld, Verdict::TooLittleStructure { .. }), "{unheld:?}");
    }

    #[test]
    fn protection_turns_with_the_vehicle_and_grows_as_the_risk_shrinks() {
        let checks = Integrity { tail: 1.0, ..Integrity::default() };
        let east = answer().protection(&checks, 1e-3);
        assert!((east.along_m / east.cross_m - 2.0).abs() < 1e-9);
        let pose = Pose2::new(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let north = Alignment { pose, ..answer() }.protection(&checks, 1e-3);
        assert!((north.cross_m - east.along_m).abs() < 1e-9);
        assert!(answer().protection(&checks, 1e-6).along_m > east.along_m);
        // sqrt(2 ln 1000) = 3.717
        assert!((east.along_m - 0.2 * 3.717).abs() < 1e-3);
    }
}
