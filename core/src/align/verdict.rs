//! May the answer be used, and how large can its error be?
//!
//! A correlation score is not a likelihood: neighbouring returns come from the same structure and
//! are not independent. The curvature of the score is therefore divided by a temperature that was
//! measured on drives with known truth, and the map's own error is added as a floor.

use nalgebra::Matrix3;

use super::climb::Summit;
use super::engine::Question;
use super::score::Field;
use super::{Alignment, Alternatives};
use crate::geo::CELL_M;
use crate::pose::{Pose2, wrap_angle};

/// What an answer must pass, and the calibration of its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Integrity {
    /// Points a thinned batch must have.
    pub min_points: usize,
    /// Share of the batch that must lie in tiles the map has.
    pub min_coverage: f64,
    /// Share of the batch that must lie on mapped structure.
    pub min_matched: f64,
    /// A detection lies on mapped structure when a map point is this near, metres.
    pub matched_within_m: f64,
    /// Score of the answer, relative to that of a random pose, below which it is no better than one.
    pub min_contrast: f64,
    /// Log-likelihood, in nats, by which the answer must exceed a second pose.
    pub min_margin: f64,
    /// Largest sigma of the answer along any direction, metres, that still tells a place.
    pub max_sigma_m: f64,
    /// Independent returns count for this many points of a thinned batch, where hills are compared.
    pub score_temperature: f64,
    /// The same for the summit's curvature, on squared weights.
    pub temperature: f64,
    /// Error of the poses that one pass was mapped from: one sigma along each axis, metres. The
    /// passes of a crowd average it out.
    pub map_pose_m: f64,
    /// Error of the map that no number of passes averages out: one sigma along each axis, metres.
    pub floor_m: f64,
    /// Error of the map's heading: one sigma, radians.
    pub floor_yaw_rad: f64,
    /// Factor on the protection levels that covers the heavier-than-Gaussian tail.
    pub tail: f64,
}

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
    /// Variance of the map's own error along each axis, square metres, where it amounts to so many surveys.
    #[must_use]
    pub fn map_variance(&self, passes: f64) -> f64 {
        self.map_pose_m.powi(2) / passes + self.floor_m.powi(2)
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
    /// The batch tells too little.
    TooLittleStructure {
        /// Its points, thinned.
        points: usize,
        /// Sigma of the answer in its worst direction, metres; infinite where nothing holds it.
        sigma_m: f64,
    },
    /// The place is clear, but too little of what the batch saw is in the map: the street has changed.
    MapStale {
        /// The share that is.
        matched_fraction: f64,
    },
    /// The best pose lies on the edge of the search: the prior is wrong by more than it says.
    PriorOutsideSearch,
    /// The map covers too little of what the batch saw.
    TooLittleMap {
        /// The share it covers.
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

/// The facts an answer is judged by.
pub(super) struct Case<'a> {
    pub question: &'a Question<'a>,
    pub field: &'a Field<'a>,
    /// The answer, if there is any hill.
    pub answer: Option<Summit>,
    /// All summits of the rigid batch, best first; the first is the answer's hill.
    pub summits: &'a [Summit],
}

/// Points that fractions are counted on.
const SAMPLE: usize = 256;

impl Case<'_> {
    /// The answer with its verdict.
    pub(super) fn judge(&self, integrity: &Integrity) -> Alignment {
        let Question { prior, thinned, batch, search, .. } = *self.question;
        let reach_sq = (search.extent_m * search.extent_m) as f32;
        let best = self.answer.unwrap_or(Summit::NONE);
        let rigid = self.summits.first().unwrap_or(&Summit::NONE);
        let on_map = prior.corrected(&best.correction);
        let background = self.background();
        let (matched_fraction, coverage) = self.agreement(&on_map, integrity);
        // What the crowd says that the map errs by here is taken back from the answer.
        let off = self.question.view.mean_offset([on_map.x_m, on_map.y_m]);
        let truer =
            |c: &Pose2| Pose2::new(c.x_m - off.x_m, c.y_m - off.y_m, wrap_angle(c.yaw_rad - off.yaw_rad));
        let mut alignment = Alignment {
            pose: truer(&on_map),
            correction: truer(&best.correction),
            covariance: self.covariance(&best, integrity).into(),
            alternatives: self.alternatives(background, truer),
            score: rigid.score - background,
            contrast: rigid.score / background.max(f64::MIN_POSITIVE),
            margin: self.margin(integrity),
            points_used: batch.points.iter().filter(|[x, y]| x * x + y * y <= reach_sq).count(),
            thinned_points: thinned.len(),
            matched_fraction,
            coverage,
            searched: self.question.lattice.half_widths(),
            verdict: Verdict::Usable,
        };
        alignment.verdict = verdict(&alignment, best.at_edge || self.leaves_search(&best), integrity);
        alignment
    }

    /// True when the climb ended on the edge of what was searched, or beyond.
    fn leaves_search(&self, best: &Summit) -> bool {
        let ((half_m, half_yaw_rad), correction) = (self.question.lattice.half_widths(), best.correction);
        let shift = correction.x_m.abs().max(correction.y_m.abs());
        shift > half_m - CELL_M || correction.yaw_rad.abs() > half_yaw_rad
    }

    /// What the score is at a random shift: the mean over a lattice of the search.
    fn background(&self) -> f64 {
        const LATTICE: i32 = 2;
        let Question { prior, thinned, lattice, .. } = *self.question;
        let sample = || thinned.iter().step_by(thinned.len() / SAMPLE + 1);
        let step = lattice.half_widths().0.max(1.0) / f64::from(LATTICE);
        let shifts = (-LATTICE..=LATTICE).flat_map(|i| (-LATTICE..=LATTICE).map(move |j| (i, j)));
        let pose = |(i, j)| prior.corrected(&Pose2::new(f64::from(i) * step, f64::from(j) * step, 0.0));
        let (mut sum, mut count) = (0.0, 0.0);
        for shift in shifts {
            sum += self.field.value(sample(), &pose(shift), prior.scale);
            count += sample().len() as f64;
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }

    /// Shares of the batch that lie on mapped structure and in mapped tiles.
    fn agreement(&self, pose: &Pose2, integrity: &Integrity) -> (f64, f64) {
        let Question { prior, thinned, view, .. } = *self.question;
        let (mut matched, mut covered, mut all) = (0_u32, 0_u32, 0_u32);
        for [x, y, _] in thinned.iter().step_by(thinned.len() / SAMPLE + 1) {
            all += 1;
            let place = pose.transform([f64::from(*x) * prior.scale, f64::from(*y) * prior.scale]);
            let Some(tile) = view.tile_below(place) else { continue };
            covered += 1;
            let near = tile.points.distance_m(place).is_some_and(|d| d <= integrity.matched_within_m);
            matched += u32::from(near);
        }
        let share = |n: u32| if all > 0 { f64::from(n) / f64::from(all) } else { 0.0 };
        (share(matched), share(covered))
    }

    /// Log-likelihood by which the answer's hill exceeds the next one, nats; infinite without a next one.
    fn margin(&self, integrity: &Integrity) -> f64 {
        let Some((best, rest)) = self.summits.split_first() else { return 0.0 };
        let apart = self.question.search.separation_m;
        let next = rest.iter().find(|s| s.correction.distance_m(&best.correction) >= apart);
        let votes = self.question.thinned.len() as f64 / integrity.score_temperature;
        next.map_or(f64::INFINITY, |next| votes * (best.score - next.score))
    }

    /// Summits that are not the answer's, by their score above the background.
    fn alternatives(&self, background: f64, truer: impl Fn(&Pose2) -> Pose2) -> Alternatives {
        let mut others = Alternatives::default();
        let Some((best, rest)) = self.summits.split_first() else { return others };
        for other in rest {
            let distinct = |p: &Pose2| p.distance_m(&other.correction) >= self.question.search.separation_m;
            if distinct(&best.correction)
                && others.iter().all(|(pose, _)| {
                    pose.distance_m(&truer(&other.correction)) >= self.question.search.separation_m
                })
            {
                // An answer that is no better than a random shift is rivalled by everything.
                let above = best.score - background;
                let relative = if above > 0.0 { (other.score - background) / above } else { 1.0 };
                others.push(truer(&other.correction), relative.clamp(0.0, 1.0));
            }
        }
        others
    }

    /// The inverse information times the temperature, and what no number of returns can tell: the
    /// map's own error.
    fn covariance(&self, best: &Summit, integrity: &Integrity) -> Matrix3<f64> {
        let inverse = best.information.cholesky().map(|c| c.inverse() * integrity.temperature);
        let unheld = Matrix3::from_diagonal_element(f64::INFINITY);
        let Some(mut covariance) = inverse.filter(|c| c.iter().all(|v| v.is_finite())) else { return unheld };
        let floor = integrity.map_variance(self.question.view.typical_passes());
        covariance[(0, 0)] += floor;
        covariance[(1, 1)] += floor;
        covariance[(2, 2)] += integrity.floor_yaw_rad.powi(2);
        covariance
    }
}

/// The first check that the answer does not pass.
fn verdict(answer: &Alignment, at_edge: bool, integrity: &Integrity) -> Verdict {
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
