//! May the answer be used, and how large can its error be?
//!
//! A correlation score is not a likelihood: neighbouring returns come from the same structure and
//! are not independent. The curvature of the score is therefore divided by a temperature that was
//! measured on drives with known truth, and the map's own error is added as a floor.

use super::refine::{Refined, Score, inverse_of_positive};
use super::{Alignment, Correlation, PreparedMap, Prior, Search};
use crate::batch::Batch;
use crate::pose::{Pose2, wrap_angle};

/// What an answer must pass, and the calibration of its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Integrity {
    /// Occupied cells a batch must have.
    pub min_batch_cells: usize,
    /// Share of the batch that must lie in tiles the map has.
    pub min_coverage: f64,
    /// Share of the batch that must lie on mapped structure.
    pub min_matched: f64,
    /// A detection lies on mapped structure when a map point is this near, metres.
    pub matched_within_m: f64,
    /// Relative score up to which a second pose is tolerated.
    pub max_alternative: f64,
    /// Largest sigma of the answer along any direction, metres, that still tells a place.
    pub max_sigma_m: f64,
    /// Independent returns count for this many detections of a batch.
    pub temperature: f64,
    /// Error of the poses that one pass was mapped from: one sigma along each axis, metres. The
    /// passes of a crowd average it out.
    pub map_pose_m: f64,
    /// Error of the map's heading: one sigma, radians.
    pub floor_yaw_rad: f64,
    /// Scale error of the odometry that organised the batch: one sigma, metres a metre. Half of
    /// what it adds up to over the batch shows along the heading.
    pub odometry_scale: f64,
    /// Heading drift of that odometry: one sigma, radians a second.
    pub odometry_yaw_radps: f64,
    /// Factor on the protection levels that covers the heavier-than-Gaussian tail.
    pub tail: f64,
}

impl Default for Integrity {
    fn default() -> Self {
        Self {
            min_batch_cells: 500,
            min_coverage: 0.7,
            min_matched: 0.5,
            matched_within_m: 0.3,
            max_alternative: 0.75,
            max_sigma_m: 0.5,
            temperature: 60.0,
            map_pose_m: 0.13,
            floor_yaw_rad: 0.001,
            odometry_scale: 0.005,
            odometry_yaw_radps: 0.02_f64.to_radians(),
            tail: 1.3,
        }
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
    },
    /// The batch tells too little.
    TooLittleStructure {
        /// Its occupied cells.
        batch_cells: usize,
        /// Sigma of the answer in its worst direction, metres; infinite where nothing holds it.
        sigma_m: f64,
    },
    /// Too little of the batch is found in the map.
    DisagreesWithMap {
        /// The share that is.
        matched_fraction: f64,
    },
    /// The best pose lies on the edge of the search.
    AtEdgeOfSearch,
    /// The map covers too little of what the batch saw.
    TooLittleMap {
        /// The share it covers.
        coverage: f64,
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

/// What is found when there is no peak at all: the prior itself, which no check lets pass.
const NOTHING: Refined =
    Refined { correction: Pose2::IDENTITY, score: 0.0, hessian: [[0.0; 3]; 3], at_edge: true };

/// The facts an answer is judged by.
pub(super) struct Case<'a> {
    pub map: &'a PreparedMap,
    pub batch: &'a Batch,
    pub prior: &'a Prior,
    pub search: &'a Search,
    pub correlation: &'a Correlation,
    /// Points that were correlated, ground metres in the body's frame.
    pub points: &'a [[f64; 2]],
    /// Climbed peaks, best first.
    pub found: &'a [Refined],
    pub batch_cells: usize,
}

impl Case<'_> {
    /// The answer with its verdict.
    pub(super) fn judge(&self, integrity: &Integrity) -> Alignment {
        let best = self.found.first().copied().unwrap_or(NOTHING);
        let background = self.background();
        let covariance = self.covariance(&best, integrity);
        let pose = self.corrected(&best.correction);
        let placed = || self.points.iter().map(|p| pose.transform(p.map(|v| v * self.prior.scale)));
        let mut alignment = Alignment {
            pose,
            correction: best.correction,
            covariance,
            alternatives: self.alternatives(&best, background),
            score: best.score - background,
            points_used: self.points.len(),
            batch_cells: self.batch_cells,
            matched_fraction: self.map.points().matched_fraction(placed(), integrity.matched_within_m),
            coverage: self.map.window().coverage(placed()),
            searched: self.searched(),
            verdict: Verdict::Usable,
        };
        alignment.verdict = verdict(&alignment, best.at_edge || self.leaves_search(&best), integrity);
        alignment
    }

    fn corrected(&self, correction: &Pose2) -> Pose2 {
        let prior = self.prior.pose;
        Pose2::new(
            prior.x_m + correction.x_m,
            prior.y_m + correction.y_m,
            wrap_angle(prior.yaw_rad + correction.yaw_rad),
        )
    }

    /// True when the climb ended on the edge of what was searched, or beyond.
    fn leaves_search(&self, best: &Refined) -> bool {
        let ((half_m, half_yaw_rad), correction) = (self.searched(), best.correction);
        let shift = correction.x_m.abs().max(correction.y_m.abs());
        shift > half_m - crate::geo::CELL_M || correction.yaw_rad.abs() > half_yaw_rad
    }

    fn searched(&self) -> (f64, f64) {
        let yaw = self.correlation.turns as f64 * self.correlation.yaw_step_rad;
        (self.correlation.lag as f64 * crate::geo::CELL_M, yaw)
    }

    /// What the score is at a random shift: the mean over a lattice of the search.
    fn background(&self) -> f64 {
        const LATTICE: i32 = 3;
        let score = self.score();
        let step = self.searched().0 / f64::from(LATTICE);
        let lattice = || -LATTICE..=LATTICE;
        let values = lattice().flat_map(|i| lattice().map(move |j| (i, j)));
        let sum: f64 =
            values.clone().map(|(i, j)| score.at([f64::from(i) * step, f64::from(j) * step, 0.0])).sum();
        sum / values.count() as f64
    }

    fn score(&self) -> Score<'_> {
        Score::new(self.map.surface(), self.map.frame(), self.points, self.prior)
    }

    /// Climbed peaks that are not the answer, by their score above the background.
    fn alternatives(&self, best: &Refined, background: f64) -> Vec<(Pose2, f64)> {
        let mut others: Vec<(Pose2, f64)> = Vec::new();
        for other in self.found.iter().skip(1) {
            let distinct = |p: &Pose2| p.distance_m(&other.correction) >= self.search.separation_m;
            if distinct(&best.correction) && others.iter().all(|(pose, _)| distinct(pose)) {
                // An answer that is no better than a random shift is rivalled by everything.
                let above = best.score - background;
                let relative = if above > 0.0 { (other.score - background) / above } else { 1.0 };
                others.push((other.correction, relative.clamp(0.0, 1.0)));
            }
        }
        others
    }

    /// The inverse curvature of the summed score, times the temperature, and what neither it nor
    /// any number of returns can tell: the map's own error and the odometry's drift.
    fn covariance(&self, best: &Refined, integrity: &Integrity) -> [[f64; 3]; 3] {
        let independent = self.points.len() as f64 / integrity.temperature;
        let information = best.hessian.map(|row| row.map(|v| -v * independent));
        let mut covariance = inverse_of_positive(information).unwrap_or([
            [f64::INFINITY, 0.0, 0.0],
            [0.0, f64::INFINITY, 0.0],
            [0.0, 0.0, f64::INFINITY],
        ]);
        let floor = integrity.map_pose_m.powi(2) / self.map.window().typical_passes();
        let drift = (0.5 * integrity.odometry_scale * self.batch.travelled_m).powi(2);
        let (s, c) = self.corrected(&best.correction).yaw_rad.sin_cos();
        covariance[0][0] += floor + c * c * drift;
        covariance[0][1] += c * s * drift;
        covariance[1][0] += c * s * drift;
        covariance[1][1] += floor + s * s * drift;
        let turned = 0.5 * integrity.odometry_yaw_radps * self.batch.duration_s;
        covariance[2][2] += integrity.floor_yaw_rad.powi(2) + turned.powi(2);
        covariance
    }
}

/// The first check that the answer does not pass.
fn verdict(answer: &Alignment, at_edge: bool, integrity: &Integrity) -> Verdict {
    let sigma_m = worst_sigma_m(&answer.covariance);
    let second = answer.alternatives.iter().map(|(_, score)| *score).fold(0.0, f64::max);
    let Alignment { batch_cells, coverage, matched_fraction, .. } = *answer;
    if batch_cells < integrity.min_batch_cells {
        Verdict::TooLittleStructure { batch_cells, sigma_m }
    } else if coverage < integrity.min_coverage {
        Verdict::TooLittleMap { coverage }
    } else if matched_fraction < integrity.min_matched {
        Verdict::DisagreesWithMap { matched_fraction }
    } else if at_edge {
        Verdict::AtEdgeOfSearch
    } else if second > integrity.max_alternative {
        Verdict::Ambiguous { relative_score: second }
    } else if sigma_m > integrity.max_sigma_m || !sigma_m.is_finite() {
        Verdict::TooLittleStructure { batch_cells, sigma_m }
    } else {
        Verdict::Usable
    }
}

/// Square root of the larger eigenvalue of the position's covariance, metres.
fn worst_sigma_m(covariance: &[[f64; 3]; 3]) -> f64 {
    let [[xx, xy, _], [_, yy, _], _] = *covariance;
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    if mean.is_finite() { (mean + half.hypot(xy)).sqrt() } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer() -> Alignment {
        Alignment {
            pose: Pose2::IDENTITY,
            correction: Pose2::IDENTITY,
            covariance: [[0.04, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 1e-6]],
            alternatives: vec![(Pose2::new(5.0, 0.0, 0.0), 0.3)],
            score: 1.0,
            points_used: 7000,
            batch_cells: 5000,
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
        assert_eq!(verdict(&answer(), true, &checks), Verdict::AtEdgeOfSearch);
        assert!(matches!(
            judged(|a| a.batch_cells = 10),
            Verdict::TooLittleStructure { batch_cells: 10, .. }
        ));
        assert!(matches!(judged(|a| a.coverage = 0.1), Verdict::TooLittleMap { .. }));
        assert!(matches!(judged(|a| a.matched_fraction = 0.1), Verdict::DisagreesWithMap { .. }));
        assert!(matches!(judged(|a| a.alternatives[0].1 = 0.99), Verdict::Ambiguous { .. }));
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
