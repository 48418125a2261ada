//! One fix beside the truth, a row of the file of `--epochs`.

use echofix_core::pose::{Pose2, wrap_angle};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::Serialize;

use super::condition::Condition;
use super::method::MethodAnswer;

/// A fix farther off than this is wrong, metres.
pub const WRONG_M: f64 = 1.0;

/// One fix beside the truth.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct EpochRecord {
    /// The kind of site: a town, one of the scenes, or a drive log.
    #[serde(rename = "place")]
    pub site_kind: &'static str,
    /// Name of the world.
    pub world: String,
    /// Epoch within the world, from 0.
    pub epoch: usize,
    /// Number of its block. Epochs of one block are near in time and space, and not independent.
    pub block: usize,
    /// Reference time of the batch, microseconds since the Unix epoch.
    pub time_us: i64,
    /// Number of the prior within the epoch, from 0.
    pub prior: usize,
    /// The conditions; the next five columns give them.
    #[serde(skip)]
    pub condition: Condition,
    /// Length of the batch, seconds.
    pub batch_s: f64,
    /// Standard deviation of the trajectory's drift after 5 s, metres; 0 without drift.
    pub drift_m: f64,
    /// Standard deviation of its heading's drift after 5 s, degrees.
    pub drift_deg: f64,
    /// How the drift grows; empty without drift.
    pub growth: &'static str,
    /// Number of contributors to the map.
    pub contributors: usize,
    /// Whether all conditions were evaluated at this epoch.
    pub swept: bool,
    /// Name of the method.
    pub method: &'static str,
    /// Speed over ground, metres per second.
    pub speed_mps: f64,
    /// Number of the batch's points.
    pub points: usize,
    /// Number of cells that they occupy.
    pub cells: usize,
    /// The verdict in a word.
    pub verdict: &'static str,
    /// Whether the answer may be used.
    pub usable: bool,
    /// Error of the newest pose along the true heading, metres.
    pub along_m: f64,
    /// Across it, metres.
    pub cross_m: f64,
    /// Of the heading, degrees.
    pub yaw_deg: f64,
    /// Error of the offset of the drifted trajectory as a whole, as the paper measures it, metres.
    pub offset_m: f64,
    /// Of its heading, degrees.
    pub offset_deg: f64,
    /// Horizontal difference from the vehicle's own positioning, metres.
    pub reference_m: Option<f64>,
    /// Of the heading, degrees.
    pub reference_deg: Option<f64>,
    /// The map's own error here, metres; empty where it is not known.
    pub floor_m: Option<f64>,
    /// Of its heading, degrees.
    pub floor_deg: Option<f64>,
    /// Horizontal error without the map's own error, metres.
    pub net_m: Option<f64>,
    /// Normalised error squared of the position, 2 degrees of freedom.
    pub nees_2: Option<f64>,
    /// Normalised error squared of position and heading, 3 degrees of freedom.
    pub nees_3: Option<f64>,
    /// Protection level along the heading, metres.
    pub protection_along_m: Option<f64>,
    /// Across it, metres.
    pub protection_cross_m: Option<f64>,
    /// Of the heading, degrees.
    pub protection_yaw_deg: Option<f64>,
    /// Score of the best alternative relative to the answer's.
    pub second: f64,
    /// Log-likelihood by which the answer exceeds the best alternative, nats; empty where it is not known.
    pub margin: Option<f64>,
    /// Milliseconds of the fix.
    pub ms: f64,
    /// The verdict that the map alone expects at the true position; empty without a prediction.
    pub forecast: &'static str,
    /// The expected horizontal sigma, without the map's own error, metres.
    pub forecast_m: Option<f64>,
    /// The expected sigma along the weakest axis, with the map's own error, metres.
    pub forecast_weakest_m: Option<f64>,
    /// The expected margin over the best pose elsewhere, nats.
    pub forecast_margin: Option<f64>,
}

/// The poses that an answer is compared with.
pub struct Facts {
    /// True pose at the reference time: map metres, radians.
    pub truth: Pose2,
    /// The pose of the vehicle's own positioning.
    pub reference: Option<Pose2>,
    /// The pose that the drifted trajectory leads to, from the true pose at its start. The trajectory's offset is measured
    /// from it.
    pub drifted: Pose2,
    /// Map metres a ground metre.
    pub scale: f64,
    /// Mean error of the map's own poses here: map metres, radians.
    pub floor: Option<Pose2>,
}

impl EpochRecord {
    /// This row with the answer of a method.
    #[must_use]
    pub fn answered(mut self, outcome: &MethodAnswer, facts: &Facts) -> Self {
        let off = facts.truth.between(&outcome.pose);
        (self.along_m, self.cross_m) = (off.x_m / facts.scale, off.y_m / facts.scale);
        self.yaw_deg = off.yaw_rad.to_degrees();
        let offset = facts.drifted.between(&outcome.pose);
        self.offset_m = offset.x_m.hypot(offset.y_m) / facts.scale;
        self.offset_deg = offset.yaw_rad.to_degrees().abs();
        if let Some(off) = facts.reference.map(|reference| reference.between(&outcome.pose)) {
            self.reference_m = Some(off.x_m.hypot(off.y_m) / facts.scale);
            self.reference_deg = Some(off.yaw_rad.to_degrees().abs());
        }
        self.floor_m = facts.floor.map(|f| f.x_m.hypot(f.y_m) / facts.scale);
        self.floor_deg = facts.floor.map(|f| f.yaw_rad.to_degrees().abs());
        self.net_m = facts.floor.map(|f| {
            let (east, north) = (outcome.pose.x_m - facts.truth.x_m, outcome.pose.y_m - facts.truth.y_m);
            (east - f.x_m).hypot(north - f.y_m) / facts.scale
        });
        if let Some(covariance) = outcome.covariance {
            (self.nees_2, self.nees_3) = nees(&facts.truth, &outcome.pose, covariance);
        }
        if let Some(levels) = outcome.protection {
            self.protection_along_m = Some(levels.along_m);
            self.protection_cross_m = Some(levels.cross_m);
            self.protection_yaw_deg = Some(levels.yaw_rad.to_degrees());
        }
        (self.verdict, self.usable) = (outcome.verdict, outcome.usable);
        (self.second, self.margin) = (outcome.second, outcome.margin);
        self.ms = outcome.elapsed.as_secs_f64() * 1e3;
        self
    }

    /// Horizontal error of the newest pose, metres.
    #[must_use]
    pub fn error_m(&self) -> f64 {
        self.along_m.hypot(self.cross_m)
    }

    /// Horizontal protection level, metres.
    #[must_use]
    pub fn protection_m(&self) -> Option<f64> {
        Some(self.protection_along_m?.hypot(self.protection_cross_m?))
    }

    /// Whether it is wrong by more than [`WRONG_M`].
    #[must_use]
    pub fn wrong(&self) -> bool {
        self.error_m() > WRONG_M
    }

    /// How doubtful the answer is: the larger, the likelier an alternative is the right one.
    #[must_use]
    pub fn doubt(&self) -> f64 {
        self.margin.map_or(self.second, |margin| -margin)
    }

    /// Whether an error exceeds its protection level.
    #[must_use]
    pub fn beyond_protection(&self) -> bool {
        let exceeds = |error: f64, level: Option<f64>| level.is_some_and(|level| error.abs() > level);
        exceeds(self.along_m, self.protection_along_m)
            || exceeds(self.cross_m, self.protection_cross_m)
            || exceeds(self.yaw_deg, self.protection_yaw_deg)
    }
}

/// Normalised errors squared of (east, north) and of (east, north, yaw); `None` where the covariance is not positive
/// definite.
fn nees(truth: &Pose2, answer: &Pose2, covariance: [[f64; 3]; 3]) -> (Option<f64>, Option<f64>) {
    let error = Vector3::new(
        answer.x_m - truth.x_m,
        answer.y_m - truth.y_m,
        wrap_angle(answer.yaw_rad - truth.yaw_rad),
    );
    let all = Matrix3::from_fn(|i, j| covariance[i][j]);
    let horizontal: Matrix2<f64> = all.fixed_view::<2, 2>(0, 0).into();
    let two = horizontal.cholesky().map(|c| {
        let e = Vector2::new(error.x, error.y);
        e.dot(&c.solve(&e))
    });
    let three = all.cholesky().map(|c| error.dot(&c.solve(&error)));
    (two, three)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;
    use std::time::Duration;

    fn outcome(pose: Pose2, covariance: Option<[[f64; 3]; 3]>) -> MethodAnswer {
        let elapsed = Duration::from_millis(7);
        let (protection, second, margin) = (None, 0.5, Some(20.0));
        MethodAnswer {
            pose,
            covariance,
            usable: true,
            verdict: "USABLE",
            protection,
            second,
            margin,
            elapsed,
        }
    }

    #[test]
    fn errors_turn_with_the_vehicle() {
        let truth = Pose2::new(100.0, 50.0, FRAC_PI_2);
        let reference = Some(Pose2::new(100.3, 50.2, FRAC_PI_2));
        let drifted = Pose2::new(100.0, 49.0, FRAC_PI_2);
        let facts = Facts { truth, reference, drifted, scale: 0.5, floor: None };
        let row = EpochRecord::default()
            .answered(&outcome(Pose2::new(100.1, 50.2, FRAC_PI_2 + 0.01), None), &facts);
        assert!((row.along_m - 0.4).abs() < 1e-9 && (row.cross_m + 0.2).abs() < 1e-9);
        assert!((row.yaw_deg - 0.01_f64.to_degrees()).abs() < 1e-9);
        assert!((row.reference_m.unwrap() - 0.4).abs() < 1e-9);
        assert!((row.offset_m - 2.0 * 0.1_f64.hypot(1.2)).abs() < 1e-9);
        assert!(row.nees_2.is_none() && !row.wrong() && (row.ms - 7.0).abs() < 1e-9);
    }

    #[test]
    fn normalised_errors_are_squares_in_sigmas() {
        let covariance = [[0.04, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 1e-4]];
        let (two, three) = nees(&Pose2::IDENTITY, &Pose2::new(0.4, 0.1, 0.03), covariance);
        assert!((two.unwrap() - 5.0).abs() < 1e-9 && (three.unwrap() - 14.0).abs() < 1e-9);
        assert_eq!(nees(&Pose2::IDENTITY, &Pose2::IDENTITY, [[0.0; 3]; 3]), (None, None));
    }

    #[test]
    fn an_error_in_any_direction_can_exceed_its_level() {
        let level = Some(0.5);
        let row = EpochRecord {
            protection_along_m: level,
            protection_cross_m: level,
            protection_yaw_deg: level,
            ..EpochRecord::default()
        };
        assert!(!row.beyond_protection());
        assert!(EpochRecord { cross_m: -0.6, ..row.clone() }.beyond_protection());
        assert!(EpochRecord { yaw_deg: 0.6, ..row }.beyond_protection());
        assert!(!EpochRecord { along_m: 9.0, ..EpochRecord::default() }.beyond_protection());
    }
}
