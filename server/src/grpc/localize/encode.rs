//! Fixes and refusals as messages of the contract.

use std::time::Duration;

use echofix_core::align::Alignment;
use echofix_core::align::verdict::{Protection, Verdict};
use echofix_core::batch::Batch;
use echofix_core::convention::{in_words, yaw_suspect};
use echofix_core::pose::Pose2;
use echofix_proto::v1::{
    Alternative, Diagnostics, FixStatus, GeodeticPose, LocalizeResponse, MapState, ProtectionLevel,
    RelativePose, UtmPose,
};
use tonic::Status;

use crate::grpc::status;
use crate::locating::{LocateAnswer, LocateRefusal};
use crate::store::Withheld;

/// Name and version of the algorithm, as answers carry it.
const ALGORITHM: &str = "weights-drift/2";
/// The calibration behind covariance and protection levels.
const CALIBRATION: &str = "sim-downtown/2";

/// What an answer says of its batch.
pub(super) struct BatchFacts {
    detections: u32,
    duration_s: f64,
    travelled_m: f64,
    /// What is wrong with it, in words; empty when nothing is.
    findings: String,
}

impl BatchFacts {
    pub(super) fn of(batch: &Batch) -> Self {
        let detections = u32::try_from(batch.detections).unwrap_or(u32::MAX);
        let jumped = "the odometry made a step that no car can make: only what was seen after it counts";
        let findings = match (in_words(&batch.findings), batch.odometry_jumped) {
            (findings, false) => findings,
            (findings, true) if findings.is_empty() => jumped.to_owned(),
            (findings, true) => format!("{findings}; {jumped}"),
        };
        Self { detections, duration_s: batch.duration_s, travelled_m: batch.travelled_m, findings }
    }
}

pub(super) fn response(
    answer: &LocateAnswer,
    time_us: i64,
    alert_limit_m: f64,
    batch: &BatchFacts,
) -> LocalizeResponse {
    let alignment = &answer.alignment;
    let (status, status_reason) = judged(answer, alert_limit_m);
    let status_reason = with_diagnosis(status_reason, answer, batch);
    let [[xx, xy, xt], [_, yy, yt], [_, _, tt]] = alignment.covariance;
    let pose = alignment.pose;
    // Where nothing holds the pose in some direction, no number bounds its error.
    let held = [xx, xy, xt, yy, yt, tt].iter().all(|v| v.is_finite());
    let alternative = |(correction, relative_score): &(Pose2, f64)| Alternative {
        correction: Some(relative(correction)),
        relative_score: *relative_score,
    };
    LocalizeResponse {
        status: status.into(),
        status_reason,
        time_us,
        pose: Some(GeodeticPose {
            latitude_deg: answer.at.lat_deg,
            longitude_deg: answer.at.lon_deg,
            yaw_rad: answer.yaw_rad,
        }),
        utm: Some(UtmPose {
            epsg: answer.zone.epsg().into(),
            easting_m: pose.x_m,
            northing_m: pose.y_m,
            yaw_rad: pose.yaw_rad,
        }),
        correction: Some(relative(&alignment.correction)),
        covariance: if held { vec![xx, xy, xt, yy, yt, tt] } else { Vec::new() },
        protection: held.then(|| protection(answer)),
        alternatives: alignment.alternatives.iter().map(alternative).collect(),
        diagnostics: Some(diagnostics(answer, batch)),
        map: Some(MapState {
            epoch: answer.map.epoch,
            newest_day: answer.map.newest_day.into(),
            coverage: alignment.coverage,
            tiles: answer.map.tiles as u32,
            cells: answer.map.cells as u32,
        }),
        algorithm: ALGORITHM.to_owned(),
        calibration: CALIBRATION.to_owned(),
        contains_prior: answer.contains_prior,
    }
}

/// The reason of an answer that is not usable, and what seems to be wrong with the question.
fn with_diagnosis(reason: String, answer: &LocateAnswer, batch: &BatchFacts) -> String {
    if answer.alignment.verdict == Verdict::Usable {
        return reason;
    }
    let believed_rad = answer.yaw_rad - answer.alignment.correction.yaw_rad;
    let prior = yaw_suspect(believed_rad, answer.yaw_rad).filter(|_| answer.relocalized);
    let prior = prior.map(|convention| format!("; of the prior's yaw: {}", convention.question()));
    // A margin that would do elsewhere is then not enough.
    let surprise = (answer.alignment.surprise > 0.0)
        .then_some("; the prior hardly expects the answer, which asks more of it");
    let batch = Some(format!("; {}", batch.findings)).filter(|_| !batch.findings.is_empty());
    reason + surprise.unwrap_or_default() + &batch.unwrap_or_default() + &prior.unwrap_or_default()
}

fn protection(answer: &LocateAnswer) -> ProtectionLevel {
    let Protection { along_m, cross_m, yaw_rad } = answer.protection;
    let finite = [along_m, cross_m, yaw_rad].iter().all(|level| level.is_finite());
    ProtectionLevel {
        along_m,
        cross_m,
        yaw_rad,
        integrity_risk: answer.integrity_risk,
        valid: finite && answer.alignment.verdict == Verdict::Usable,
    }
}

fn diagnostics(answer: &LocateAnswer, batch: &BatchFacts) -> Diagnostics {
    let alignment = &answer.alignment;
    Diagnostics {
        detections_sent: batch.detections,
        detections_used: alignment.points_used as u32,
        batch_blocks: alignment.thinned_points as u32,
        matched_fraction: alignment.matched_fraction,
        batch_duration_s: batch.duration_s,
        travelled_m: batch.travelled_m,
        search_half_width_m: alignment.searched.0,
        search_half_yaw_rad: alignment.searched.1,
        score: alignment.score,
        queued_ms: milliseconds(answer.timing.queued),
        window_ms: milliseconds(answer.timing.window),
        align_ms: milliseconds(answer.timing.align),
        contrast: alignment.contrast,
        searched_wide: answer.relocalized,
        margin: alignment.margin,
        surprise: alignment.surprise,
        rival: alignment.rival.map(|rival| relative(&rival.correction)),
    }
}

/// The status and the sentence that gives its reason.
fn judged(answer: &LocateAnswer, alert_limit_m: f64) -> (FixStatus, String) {
    let horizontal_m = answer.protection.horizontal_m();
    // A level that is no number is within no limit.
    let within_limit = horizontal_m <= alert_limit_m;
    if answer.alignment.verdict == Verdict::Usable && alert_limit_m > 0.0 && !within_limit {
        let text = format!(
            "the horizontal protection level of {horizontal_m:.2} m exceeds the alert limit of {alert_limit_m:.2} m"
        );
        return (FixStatus::AboveAlertLimit, text);
    }
    status_and_reason(&answer.alignment)
}

/// A verdict as a status of the contract.
fn status_and_reason(alignment: &Alignment) -> (FixStatus, String) {
    let percent = |fraction: f64| fraction * 100.0;
    match alignment.verdict {
        Verdict::Usable => (
            FixStatus::Usable,
            format!(
                "{:.0} % of the batch lies on mapped structure, and the objects in view prefer no other pose",
                percent(alignment.matched_fraction)
            ),
        ),
        Verdict::Ambiguous { along_track: true, .. } => (
            FixStatus::AmbiguousAlongTrack,
            format!("the objects in view fit a pose {} along the street nearly as well", distance(alignment)),
        ),
        Verdict::Ambiguous { along_track: false, .. } => (
            FixStatus::Ambiguous,
            format!("the objects in view fit a pose {} away nearly as well", distance(alignment)),
        ),
        Verdict::TooLittleStructure { points, sigma_m } if !sigma_m.is_finite() => (
            FixStatus::TooLittleStructure,
            format!("nothing in the batch's {points} blocks of detections holds the pose in some direction"),
        ),
        Verdict::TooLittleStructure { points, sigma_m } => (
            FixStatus::TooLittleStructure,
            format!("{points} blocks of detections hold the pose to {sigma_m:.2} m (one sigma) only"),
        ),
        Verdict::MapStale { matched_fraction } => (
            FixStatus::MapStale,
            format!(
                "no other pose comes near, but too many objects in view contradict it: {:.0} % of the batch is in the map",
                percent(matched_fraction)
            ),
        ),
        Verdict::PriorOutsideSearch => (
            FixStatus::PriorOutsideSearch,
            "the best pose lies on the edge of the search, or the objects in view prefer one beyond it, or the prior hardly expects it; ask again from this one"
                .to_owned(),
        ),
        Verdict::Lost { contrast } => (
            FixStatus::Lost,
            format!("no pose explains the batch: the best scores {contrast:.2} times a random one"),
        ),
        Verdict::TooLittleMap { coverage } => {
            (FixStatus::TooLittleMap, format!("the map covers only {:.0} % of the batch", percent(coverage)))
        }
    }
}

/// How far the answer's strongest rival lies from it.
fn distance(alignment: &Alignment) -> String {
    alignment.rival.map_or_else(
        || "elsewhere".to_owned(),
        |rival| format!("{:.1} m", rival.correction.distance_m(&alignment.correction)),
    )
}

/// The refusal's reason, as `google.rpc.ErrorInfo` and the metrics name it.
pub(super) fn reason(refusal: &LocateRefusal) -> &'static str {
    match refusal {
        LocateRefusal::NoMap { .. } => "NO_MAP",
        LocateRefusal::TooSlow { .. } => "TOO_SLOW",
        LocateRefusal::NoDetections => "NO_DETECTIONS",
        LocateRefusal::TooFewDetections { .. } => "TOO_FEW_DETECTIONS",
        LocateRefusal::WrongConvention(_) => "WRONG_CONVENTION",
        LocateRefusal::PriorTooUncertain { .. } => "PRIOR_TOO_UNCERTAIN",
        LocateRefusal::Place(_) => "OUTSIDE_UTM",
        LocateRefusal::Overloaded { .. } => "OVERLOADED",
        LocateRefusal::Store(_) => "MAP_UNREADABLE",
        LocateRefusal::Ending => "ENDING",
        LocateRefusal::Gone => "GONE",
    }
}

pub(super) fn refused(refusal: &LocateRefusal) -> Status {
    match refusal {
        LocateRefusal::Overloaded { retry_after, .. } => status::overloaded(refusal, *retry_after),
        LocateRefusal::Store(error) => status::store(error),
        LocateRefusal::Ending => status::unavailable(refusal, Duration::from_secs(1)),
        LocateRefusal::Gone => status::gone(),
        LocateRefusal::NoMap { withheld, .. } => {
            let Withheld { contributors, needed } =
                withheld.unwrap_or(Withheld { contributors: 0, needed: 0 });
            let seen = [("contributors", contributors.to_string()), ("needed", needed.to_string())];
            status::refused(reason(refusal), refusal, if withheld.is_some() { &seen } else { &[] })
        }
        _ => status::refused(reason(refusal), refusal, &[]),
    }
}

fn relative(pose: &Pose2) -> RelativePose {
    RelativePose { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad }
}

pub(super) fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
