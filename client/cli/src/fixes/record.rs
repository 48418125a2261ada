//! One question, what came of it, and how far off it was.

use echofix_client::refusal::CallError;
use echofix_client::vehicle::LocalizationQuestion;
use echofix_core::drive::GeoPose;
use echofix_proto::v1::{FixStatus, LocalizeResponse};
use prost::Message;
use serde::Serialize;

use super::truth::Truth;

/// One question and what came of it.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Fix {
    /// Time asked for, microseconds since the Unix epoch.
    pub time_us: i64,
    /// The verdict, or the reason of the refusal.
    pub outcome: String,
    /// The service's words.
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
    /// Share of the batch that lies on mapped structure.
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

impl Fix {
    /// Horizontal error, metres.
    pub fn error_m(&self) -> Option<f64> {
        Some(self.error_along_m?.hypot(self.error_cross_m?))
    }
}

/// The record of an answer or a refusal.
pub(super) fn record(
    question: &LocalizationQuestion,
    truth: &Truth,
    true_pose: &GeoPose,
    answer: Result<LocalizeResponse, CallError>,
    round_trip_ms: f64,
) -> Fix {
    let request_bytes = question.request.encoded_len();
    let mut fix = Fix { time_us: question.time_us(), round_trip_ms, request_bytes, ..Fix::default() };
    match answer {
        Ok(answer) => fill(&mut fix, &answer, truth, true_pose),
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

fn fill(fix: &mut Fix, answer: &LocalizeResponse, truth: &Truth, true_pose: &GeoPose) {
    let status = answer.status();
    let name = status.as_str_name();
    name.strip_prefix("FIX_STATUS_").unwrap_or(name).clone_into(&mut fix.outcome);
    fix.detail.clone_from(&answer.status_reason);
    fix.usable = status == FixStatus::Usable;
    if let Some(pose) = &answer.pose
        && let Ok([along, cross, yaw]) = truth.error(pose, true_pose)
    {
        (fix.latitude_deg, fix.longitude_deg) = (Some(pose.latitude_deg), Some(pose.longitude_deg));
        fix.yaw_rad = Some(pose.yaw_rad);
        (fix.error_along_m, fix.error_cross_m) = (Some(along), Some(cross));
        fix.error_yaw_deg = Some(yaw.to_degrees());
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
