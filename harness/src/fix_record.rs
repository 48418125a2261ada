//! One question, its answer, and how far off it was.

use echofix_client::refusal::CallError;
use echofix_core::drive::GeoPose;
use echofix_proto::v1::{FixStatus, LocalizeResponse};
use nalgebra::{Matrix3, Vector3};
use prost::Message;
use serde::Serialize;

use crate::questions::{DriveQuestions, TruthQuestion};
use crate::truth::{AnswerError, Truth};

/// One question and its answer: a row of what `echofix localize --out` writes.
#[derive(Debug, Clone, Default, Serialize)]
pub struct FixRecord {
    /// Time asked for, microseconds since the Unix epoch.
    pub time_us: i64,
    /// The verdict, or the reason of the refusal.
    pub outcome: String,
    /// The service's reason, in words.
    pub detail: String,
    /// Whether the answer may be used.
    pub usable: bool,
    /// Answered position, degrees north; empty when refused.
    pub latitude_deg: Option<f64>,
    /// Answered position, degrees east.
    pub longitude_deg: Option<f64>,
    /// Answered heading, radians counter-clockwise from true east.
    pub yaw_rad: Option<f64>,
    /// Error along the true heading, metres.
    pub error_along_m: Option<f64>,
    /// Error across it, metres.
    pub error_cross_m: Option<f64>,
    /// Error of the heading, degrees.
    pub error_yaw_deg: Option<f64>,
    /// Protection level along the heading, metres; empty when not valid.
    pub protection_along_m: Option<f64>,
    /// Protection level across it, metres; empty when not valid.
    pub protection_cross_m: Option<f64>,
    /// Protection level of the heading, degrees; empty when not valid.
    pub protection_yaw_deg: Option<f64>,
    /// Variance of the position along grid east, square metres; the six are empty where nothing holds the pose.
    pub covariance_east_east_m2: Option<f64>,
    /// Covariance of east and north, square metres.
    pub covariance_east_north_m2: Option<f64>,
    /// Covariance of east and the heading, metres times radians.
    pub covariance_east_yaw_m_rad: Option<f64>,
    /// Variance of the position along grid north, square metres.
    pub covariance_north_north_m2: Option<f64>,
    /// Covariance of north and the heading, metres times radians.
    pub covariance_north_yaw_m_rad: Option<f64>,
    /// Variance of the heading, square radians.
    pub covariance_yaw_yaw_rad2: Option<f64>,
    /// Squared error along the heading over its variance: 1 on average where the covariance is honest.
    pub nees_along: Option<f64>,
    /// The same across it.
    pub nees_cross: Option<f64>,
    /// The same of the heading.
    pub nees_yaw: Option<f64>,
    /// Normalised estimation error squared of all three: 3 on average where the covariance is honest.
    pub nees: Option<f64>,
    /// Fraction of the batch that lies on mapped structure.
    pub matched_fraction: Option<f64>,
    /// Detections that were correlated.
    pub detections_used: Option<u32>,
    /// Milliseconds the service computed (window and alignment).
    pub server_ms: Option<f64>,
    /// Milliseconds from question to answer.
    pub round_trip_ms: f64,
    /// Bytes of the request.
    pub request_bytes: usize,
}

impl FixRecord {
    /// The record of an answer or a refusal to a drive's question.
    pub fn of(
        asked: &DriveQuestions,
        index: usize,
        answer: Result<LocalizeResponse, CallError>,
        round_trip_ms: f64,
    ) -> Self {
        let TruthQuestion { question, truth } = &asked.questions[index];
        let request_bytes = question.request.encoded_len();
        let mut fix = Self { time_us: question.time_us(), round_trip_ms, request_bytes, ..Self::default() };
        match answer {
            Ok(answer) => fill(&mut fix, &answer, &asked.truth, truth),
            Err(CallError::Refused { reason, message }) => {
                (fix.outcome, fix.detail) = (reason.reason().to_owned(), message);
            }
            Err(error) => {
                let text = error.to_string();
                (fix.outcome, fix.detail) =
                    (text.split([':', ';', ',']).next().unwrap_or("failed").to_owned(), text);
            }
        }
        fix
    }

    /// True when an error exceeds its valid protection level: along, across, or of the heading.
    pub fn is_beyond_protection(&self) -> bool {
        let exceeds = |error: Option<f64>, level: Option<f64>| {
            error.zip(level).is_some_and(|(error, level)| error.abs() > level)
        };
        exceeds(self.error_along_m, self.protection_along_m)
            || exceeds(self.error_cross_m, self.protection_cross_m)
            || exceeds(self.error_yaw_deg, self.protection_yaw_deg)
    }

    /// Horizontal error, metres.
    pub fn error_m(&self) -> Option<f64> {
        Some(self.error_along_m?.hypot(self.error_cross_m?))
    }
}

fn fill(fix: &mut FixRecord, answer: &LocalizeResponse, truth: &Truth, true_pose: &GeoPose) {
    let status = answer.status();
    let name = status.as_str_name();
    name.strip_prefix("FIX_STATUS_").unwrap_or(name).clone_into(&mut fix.outcome);
    fix.detail.clone_from(&answer.status_reason);
    fix.usable = status == FixStatus::Usable;
    if let Some(pose) = &answer.pose
        && let Ok(error) = truth.error(pose, true_pose)
    {
        (fix.latitude_deg, fix.longitude_deg) = (Some(pose.latitude_deg), Some(pose.longitude_deg));
        fix.yaw_rad = Some(pose.yaw_rad);
        (fix.error_along_m, fix.error_cross_m) = (Some(error.along_m), Some(error.cross_m));
        fix.error_yaw_deg = Some(error.yaw_rad.to_degrees());
        consistency(fix, answer, &error);
    }
    if let Some(levels) = answer.protection.as_ref().filter(|p| p.valid) {
        (fix.protection_along_m, fix.protection_cross_m) = (Some(levels.along_m), Some(levels.cross_m));
        fix.protection_yaw_deg = Some(levels.yaw_rad.to_degrees());
    }
    if let Some(diagnostics) = &answer.diagnostics {
        fix.matched_fraction = Some(diagnostics.matched_fraction);
        fix.detections_used = Some(diagnostics.detections_used);
        fix.server_ms = Some(diagnostics.window_ms + diagnostics.align_ms);
    }
}

/// The answer's covariance, and the errors over it.
fn consistency(fix: &mut FixRecord, answer: &LocalizeResponse, error: &AnswerError) {
    let (&[ee, en, et, nn, nt, tt], Some(utm)) = (&answer.covariance[..], &answer.utm) else { return };
    (fix.covariance_east_east_m2, fix.covariance_east_north_m2) = (Some(ee), Some(en));
    (fix.covariance_east_yaw_m_rad, fix.covariance_north_north_m2) = (Some(et), Some(nn));
    (fix.covariance_north_yaw_m_rad, fix.covariance_yaw_yaw_rad2) = (Some(nt), Some(tt));
    // Onto the heading: along, across, yaw.
    let (s, c) = utm.yaw_rad.sin_cos();
    let turn = Matrix3::new(c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0);
    let covariance = turn * Matrix3::new(ee, en, et, en, nn, nt, et, nt, tt) * turn.transpose();
    let error = Vector3::new(error.along_m, error.cross_m, error.yaw_rad);
    let axis = |i: usize| Some(error[i] * error[i] / covariance[(i, i)]).filter(|nees| nees.is_finite());
    (fix.nees_along, fix.nees_cross, fix.nees_yaw) = (axis(0), axis(1), axis(2));
    fix.nees = covariance.cholesky().map(|c| error.dot(&c.solve(&error)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_proto::v1::UtmPose;

    /// Catches: a field that was renamed, and with it a column that scripts read.
    #[test]
    fn the_columns_of_a_fix_stay_as_they_are() {
        let json = serde_json::to_value(FixRecord::default()).unwrap();
        let columns: Vec<_> = json.as_object().unwrap().keys().map(String::as_str).collect();
        let expected = "covariance_east_east_m2 covariance_east_north_m2 covariance_east_yaw_m_rad \
                        covariance_north_north_m2 covariance_north_yaw_m_rad covariance_yaw_yaw_rad2 \
                        detail detections_used error_along_m error_cross_m error_yaw_deg latitude_deg \
                        longitude_deg matched_fraction nees nees_along nees_cross nees_yaw outcome \
                        protection_along_m protection_cross_m protection_yaw_deg request_bytes \
                        round_trip_ms server_ms time_us usable yaw_rad";
        assert_eq!(columns, expected.split_whitespace().collect::<Vec<_>>());
    }
    /// Catches: a covariance that is turned the wrong way, a heading that no level bounds.
    #[test]
    fn errors_are_judged_along_their_own_axes() {
        // Heading north: along is north, where it errs by 0.4 m with a sigma of 0.2 m.
        let answer = LocalizeResponse {
            covariance: vec![0.01, 0.0, 0.0, 0.04, 0.0, 1e-4],
            utm: Some(UtmPose { yaw_rad: std::f64::consts::FRAC_PI_2, ..UtmPose::default() }),
            ..LocalizeResponse::default()
        };
        let mut fix =
            FixRecord { error_yaw_deg: Some(1.2), protection_yaw_deg: Some(1.0), ..FixRecord::default() };
        consistency(&mut fix, &answer, &AnswerError { along_m: 0.4, cross_m: 0.1, yaw_rad: 0.02 });
        let near = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-9;
        assert!(near(fix.nees_along, 4.0) && near(fix.nees_cross, 1.0) && near(fix.nees_yaw, 4.0), "{fix:?}");
        assert!(near(fix.nees, 9.0) && fix.is_beyond_protection());
        assert!(!FixRecord { protection_yaw_deg: Some(1.3), ..fix }.is_beyond_protection());
    }
}
