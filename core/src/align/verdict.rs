//! May the answer be used, and how large can its error be?
//!
//! A score is not a likelihood: neighbouring returns come from the same structure and are not
//! independent. The curvature of the score is therefore divided by a temperature that was
//! measured on drives with known truth, and the map's own error is added as a floor.

use super::Alignment;
use crate::datum::MapVariance;
use crate::pose::Pose2;

/// What an answer must pass, and the calibration of its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Integrity {
    /// Points a thinned batch must have.
    pub min_points: usize,
    /// Fraction of the batch that must lie in tiles the map has.
    pub min_coverage: f64,
    /// Fraction of the batch that must lie on mapped structure.
    pub min_matched: f64,
    /// A detection lies on mapped structure when a map point is this near, metres.
    pub matched_within_m: f64,
    /// Score of the answer, relative to that of a random pose, below which it is no better than one.
    pub min_contrast: f64,
    /// Log-likelihood, in nats, by which the answer must exceed the best candidate elsewhere.
    pub min_margin: f64,
    /// Largest sigma of the answer along any direction, metres.
    pub max_sigma_m: f64,
    /// Independent returns count for this many points of a thinned batch, where candidates are compared.
    pub score_temperature: f64,
    /// The same for the curvature of the score, on squared weights.
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
            min_points: 300,
            min_coverage: 0.7,
            min_matched: 0.35,
            matched_within_m: 0.3,
            min_contrast: 1.3,
            min_margin: 12.0,
            max_sigma_m: 0.5,
            score_temperature: 10.0,
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
    /// A second pose explains the batch nearly as well.
    Ambiguous {
        /// Its score relative to the answer's.
        relative_score: f64,
        /// Log-likelihood by which the answer exceeds it, nats.
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
    /// The pose is clear, but too little of what the batch saw is in the map: the street has changed.
    MapStale {
        /// The fraction that is.
        matched_fraction: f64,
    },
    /// The best pose lies on the edge of the search: the prior is wrong by more than its sigmas allow.
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
    let Alignment { thinned_points: points, coverage, matched_fraction, contrast, .. } = *answer;
    let rival = answer.alternatives.first().filter(|_| answer.margin < integrity.min_margin);
    if points < integrity.min_points {
        Verdict::TooLittleStructure { points, sigma_m }
    } else if coverage < integrity.min_coverage {
        Verdict::TooLittleMap { coverage }
    } else if contrast < integrity.min_contrast {
        Verdict::Lost { contrast }
    } else if at_edge {
        Verdict::PriorOutsideSearch
    } else if let Some((other, relative_score)) = rival {
        let along_track = lies_along(answer, other);
        Verdict::Ambiguous { relative_score: *relative_score, margin: answer.margin, along_track }
    } else if sigma_m > integrity.max_sigma_m || !sigma_m.is_finite() {
        Verdict::TooLittleStructure { points, sigma_m }
    } else if matched_fraction < integrity.min_matched {
        Verdict::MapStale { matched_fraction }
    } else {
        Verdict::Usable
    }
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

    fn other(x_m: f64, y_m: f64, relative_score: f64) -> Alternatives {
        let mut others = Alternatives::default();
        others.push(Pose2::new(x_m, y_m, 0.0), relative_score);
        others
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
        assert!(matches!(judged(|a| a.matched_fraction = 0.1), Verdict::MapStale { .. }));
        assert!(matches!(judged(|a| a.contrast = 1.0), Verdict::Lost { .. }));
        assert!(matches!(judged(|a| a.margin = 1.0), Verdict::Ambiguous { along_track: true, .. }));
        let aside = judged(|a| (a.margin, a.alternatives) = (1.0, other(0.0, 5.0, 0.99)));
        assert!(matches!(aside, Verdict::Ambiguous { along_track: false, .. }), "{aside:?}");
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
