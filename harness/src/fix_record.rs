//! One question, its answer, and how far off it was.

use echofix_client::refusal::CallError;
use echofix_core::drive::GeoPose;
use echofix_proto::v1::{FixStatus, LocalizeResponse};
use prost::Message;
use serde::Serialize;

use crate::questions::{DriveQuestions, TruthQuestion};
use crate::truth::Truth;

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
    }
    if let Some(levels) = answer.protection.as_ref().filter(|p| p.valid) {
        (fix.protection_along_m, fix.protection_cross_m) = (Some(levels.along_m), Some(levels.cross_m));
    }
    if let Some(diagnostics) = &answer.diagnostics {
        fix.matched_fraction = Some(diagnostics.matched_fraction);
        fix.detections_used = Some(diagnostics.detections_used);
        fix.server_ms = Some(diagnostics.window_ms + diagnostics.align_ms);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a field that was renamed, and with it a column that scripts read.
    #[test]
    fn the_columns_of_a_fix_stay_as_they_are() {
        let json = serde_json::to_value(FixRecord::default()).unwrap();
        let columns: Vec<_> = json.as_object().unwrap().keys().map(String::as_str).collect();
        let expected = "detail detections_used error_along_m error_cross_m error_yaw_deg latitude_deg \
                        longitude_deg matched_fraction outcome protection_along_m protection_cross_m request_bytes \
                        round_trip_ms server_ms time_us usable yaw_rad";
        assert_eq!(columns, expected.split_whitespace().collect::<Vec<_>>());
    }
}
