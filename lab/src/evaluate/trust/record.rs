//! One question with all of its answer, beside the truth: a row of the file of `--epochs`.

use std::path::Path;

use echofix_core::align::verdict::Protection;
use echofix_core::align::{Alignment, Prior};
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_server::locating::verdict_word;
use serde::Serialize;

use super::case::Case;
use crate::evaluate::record::WRONG_M;

/// The verdict of an answer that may be used.
pub const USABLE: &str = "USABLE";

/// A question as it is asked.
pub struct Question<'a> {
    /// Family of the world; of drive logs [`crate::evaluate::logged::LOG`].
    pub family: &'static str,
    /// Seed of the world, or number of the drive log.
    pub seed: u64,
    /// How it is asked.
    pub case: &'a Case,
    /// Number of the batch within world and case.
    pub batch: usize,
    /// Reference time of the batch, microseconds since the Unix epoch.
    pub time_us: i64,
    /// Number of the prior.
    pub prior_number: usize,
    /// Points of the batch.
    pub points: usize,
    /// Speed, metres per second.
    pub speed_mps: f64,
    /// The prior.
    pub prior: Prior,
    /// The true pose; `None` where the vehicle is not on the map at all.
    pub truth: Option<Pose2>,
}

/// A row: what was asked, every field of the answer, and its error.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct TrustRecord {
    /// Family of the world; of drive logs [`crate::evaluate::logged::LOG`].
    pub family: &'static str,
    /// Seed of the world, or number of the drive log.
    pub seed: u64,
    /// How it was asked, or the drive log's name.
    pub case: String,
    /// The number that varies among cases of one kind.
    pub k: f64,
    /// Number of the batch within world and case. Questions of one batch are not independent.
    pub batch: usize,
    /// Number of the prior of this batch.
    pub prior: usize,
    /// Reference time, microseconds since the Unix epoch.
    pub time_us: i64,
    /// Length of the batch, seconds.
    pub batch_s: f64,
    /// Speed, metres per second.
    pub speed_mps: f64,
    /// The verdict in a word.
    pub verdict: &'static str,
    /// Whether the vehicle is on the map, so that there is a true pose.
    pub on_map: bool,
    /// Error along the true heading, ground metres; of the prior where there is no answer.
    pub along_m: f64,
    /// Error across it, ground metres.
    pub cross_m: f64,
    /// Error of the heading, degrees.
    pub yaw_deg: f64,
    /// Error of the prior along the true heading, ground metres.
    pub prior_along_m: f64,
    /// Error of the prior across it, ground metres.
    pub prior_cross_m: f64,
    /// Error of the prior's heading, degrees.
    pub prior_yaw_deg: f64,
    /// Level along the heading, metres.
    pub level_along_m: f64,
    /// Level across it, metres.
    pub level_cross_m: f64,
    /// Level of the heading, degrees.
    pub level_yaw_deg: f64,
    /// Sigma along the heading, metres.
    pub sigma_along_m: f64,
    /// Sigma across it, metres.
    pub sigma_cross_m: f64,
    /// Sigma of the heading, degrees.
    pub sigma_yaw_deg: f64,
    /// Mean weight above the background's.
    pub score: f64,
    /// Mean weight relative to the background's.
    pub contrast: f64,
    /// How clearly the objects in view prefer the answer to its strongest rival, nats.
    pub margin: f64,
    /// By how much the prior is surprised by the answer, nats.
    pub surprise: f64,
    /// Points of the batch.
    pub points: usize,
    /// Points within reach.
    pub points_used: usize,
    /// Thinned points.
    pub thinned_points: usize,
    /// Fraction of the points on mapped structure.
    pub matched_fraction: f64,
    /// Fraction of the points where there is a map.
    pub coverage: f64,
    /// Correction of the prior: metres east and north, degrees, by semicolons.
    pub correction: String,
    /// Covariance of (east m, north m, yaw rad): six numbers by semicolons, row by row from the diagonal on.
    pub covariance: String,
    /// Number of alternatives.
    pub alternatives: usize,
    /// Relative score of the best alternative; 0 without one.
    pub second: f64,
    /// Every alternative: offset from the answer along and across the answer's heading, metres, turn in degrees, relative
    /// score, by colons; alternatives by semicolons.
    pub others: String,
    /// Half width of the search: metres.
    pub searched_m: f64,
    /// Half width of the search: degrees.
    pub searched_deg: f64,
}

impl TrustRecord {
    /// A question that the service refuses.
    pub fn refused(question: &Question, verdict: &'static str) -> Self {
        let mut row = Self { verdict, ..Self::asked(question) };
        (row.along_m, row.cross_m, row.yaw_deg) = (row.prior_along_m, row.prior_cross_m, row.prior_yaw_deg);
        row
    }

    /// A question with its answer and the answer's levels. This function alone knows the answer's fields.
    pub fn answered(question: &Question, answer: &Alignment, levels: &Protection) -> Self {
        let error = question.error(&answer.pose);
        let [along, cross, yaw] = variances(answer);
        let Pose2 { x_m, y_m, yaw_rad } = answer.correction;
        let [[xx, xy, xt], [_, yy, yt], [_, _, tt]] = answer.covariance;
        Self {
            verdict: verdict_word(&answer.verdict),
            along_m: error[0],
            cross_m: error[1],
            yaw_deg: error[2],
            level_along_m: levels.along_m,
            level_cross_m: levels.cross_m,
            level_yaw_deg: levels.yaw_rad.to_degrees(),
            sigma_along_m: along.sqrt(),
            sigma_cross_m: cross.sqrt(),
            sigma_yaw_deg: yaw.sqrt().to_degrees(),
            score: answer.score,
            contrast: answer.contrast,
            margin: answer.margin,
            surprise: answer.surprise,
            points_used: answer.points_used,
            thinned_points: answer.thinned_points,
            matched_fraction: answer.matched_fraction,
            coverage: answer.coverage,
            correction: format!("{x_m:.3};{y_m:.3};{:.3}", yaw_rad.to_degrees()),
            covariance: format!("{xx:.4e};{xy:.4e};{xt:.4e};{yy:.4e};{yt:.4e};{tt:.4e}"),
            alternatives: answer.alternatives.len(),
            second: answer.alternatives.first().map_or(0.0, |(_, relative)| *relative),
            others: others(answer),
            searched_m: answer.searched.0,
            searched_deg: answer.searched.1.to_degrees(),
            ..Self::asked(question)
        }
    }

    fn asked(question: &Question) -> Self {
        let Question { case, .. } = question;
        let off = question.error(&question.prior.pose);
        Self {
            family: question.family,
            seed: question.seed,
            case: case.name.clone(),
            k: case.k,
            batch: question.batch,
            prior: question.prior_number,
            time_us: question.time_us,
            batch_s: case.form.length_s,
            speed_mps: question.speed_mps,
            on_map: question.truth.is_some(),
            prior_along_m: off[0],
            prior_cross_m: off[1],
            prior_yaw_deg: off[2],
            points: question.points,
            ..Self::default()
        }
    }

    /// Whether the answer may be used.
    pub fn usable(&self) -> bool {
        self.verdict == USABLE
    }

    /// Horizontal error, metres.
    pub fn error_m(&self) -> f64 {
        self.along_m.hypot(self.cross_m)
    }

    /// Horizontal level, metres.
    pub fn level_m(&self) -> f64 {
        self.level_along_m.hypot(self.level_cross_m)
    }

    /// Usable, and off by more than a metre; or usable where there is nothing to be found.
    pub fn wrong(&self) -> bool {
        self.usable() && (!self.on_map || self.error_m() > WRONG_M)
    }

    /// Usable, and beyond the level: along, across, heading.
    pub fn beyond(&self) -> [bool; 3] {
        let errors = [self.along_m, self.cross_m, self.yaw_deg];
        let levels = [self.level_along_m, self.level_cross_m, self.level_yaw_deg];
        [0, 1, 2].map(|axis| self.usable() && self.on_map && errors[axis].abs() > levels[axis])
    }

    /// Squared errors in sigmas: along, across, heading.
    pub fn nees(&self) -> [f64; 3] {
        let errors = [self.along_m, self.cross_m, self.yaw_deg];
        let sigmas = [self.sigma_along_m, self.sigma_cross_m, self.sigma_yaw_deg];
        [0, 1, 2].map(|axis| (errors[axis] / sigmas[axis]).powi(2))
    }
}

#[cfg(test)]
impl TrustRecord {
    /// A usable answer without error, of sigmas of a decimetre and of a tenth of a degree and levels of half of each unit.
    pub fn example() -> Self {
        Self {
            verdict: USABLE,
            on_map: true,
            sigma_along_m: 0.1,
            sigma_cross_m: 0.1,
            sigma_yaw_deg: 0.1,
            level_along_m: 0.5,
            level_cross_m: 0.5,
            level_yaw_deg: 0.5,
            ..Self::default()
        }
    }
}

impl Question<'_> {
    /// The error of a pose along and across the true heading, ground metres, and of the heading, degrees; zero where there
    /// is no truth.
    fn error(&self, pose: &Pose2) -> [f64; 3] {
        let Some(truth) = self.truth else { return [0.0; 3] };
        let off = truth.between(pose);
        [off.x_m / self.prior.scale, off.y_m / self.prior.scale, wrap_angle(off.yaw_rad).to_degrees()]
    }
}

/// Variances along and across the answer's heading, square metres, and of the heading, square radians.
fn variances(answer: &Alignment) -> [f64; 3] {
    let (s, c) = answer.pose.yaw_rad.sin_cos();
    let [[xx, xy, _], [_, yy, _], [_, _, tt]] = answer.covariance;
    [c * c * xx + 2.0 * c * s * xy + s * s * yy, s * s * xx - 2.0 * c * s * xy + c * c * yy, tt]
}

fn others(answer: &Alignment) -> String {
    let (s, c) = answer.pose.yaw_rad.sin_cos();
    let other = |(pose, relative): &(Pose2, f64)| {
        let (dx, dy) = (pose.x_m - answer.correction.x_m, pose.y_m - answer.correction.y_m);
        let turn = wrap_angle(pose.yaw_rad - answer.correction.yaw_rad).to_degrees();
        format!("{:.2}:{:.2}:{turn:.2}:{relative:.4}", c * dx + s * dy, c * dy - s * dx)
    };
    answer.alternatives.iter().map(other).collect::<Vec<_>>().join(";")
}

/// Writes rows to a CSV file.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, rows: &[TrustRecord]) -> anyhow::Result<()> {
    let mut writer = csv::Writer::from_path(path)?;
    for row in rows {
        writer.serialize(row)?;
    }
    Ok(writer.flush()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a usable answer to an unanswerable question that counts as right, and levels of answers that may not be used.
    #[test]
    fn wrong_and_beyond_are_counted_among_the_usable() {
        let usable = TrustRecord { verdict: USABLE, on_map: true, ..TrustRecord::default() };
        let levels = |row: TrustRecord| TrustRecord {
            level_along_m: 0.5,
            level_cross_m: 0.5,
            level_yaw_deg: 0.5,
            ..row
        };
        assert!(!levels(usable.clone()).wrong());
        assert!(TrustRecord { on_map: false, ..usable.clone() }.wrong());
        assert!(TrustRecord { along_m: 1.1, ..usable.clone() }.wrong());
        let off = levels(TrustRecord { cross_m: -0.6, yaw_deg: 0.4, ..usable });
        assert_eq!(off.beyond(), [false, true, false]);
        assert_eq!(TrustRecord { verdict: "LOST", ..off }.beyond(), [false; 3]);
    }
}
