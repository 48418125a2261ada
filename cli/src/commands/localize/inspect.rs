//! `echofix localize --inspect`: one question and its answer as a picture.

mod picture;

use std::path::Path;

use anyhow::{Context, ensure};
use echofix_client::refusal::CallError;
use echofix_core::drive::Drive;
use echofix_core::geo::{Grid, LatLon};
use echofix_core::odometry::Trajectory;
use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;
use echofix_harness::questions::{DriveQuestions, QuestionPlan, TruthQuestion};
use echofix_harness::replay::Answering;
use echofix_proto::v1::{Batch, LocalizeRequest, LocalizeResponse, RelativePose};

use crate::offline::OfflineLocalizer;
use picture::{Marker, Picture};

/// Half of the side of the square that is shown, metres.
const HALF_M: f64 = 60.0;

/// Refuses a file that cannot hold a picture.
///
/// # Errors
/// When its name ends otherwise.
pub fn check(out: &Path) -> anyhow::Result<()> {
    let fits = out
        .extension()
        .is_some_and(|ending| ["svg", "html"].iter().any(|known| ending.eq_ignore_ascii_case(known)));
    ensure!(fits, "{} must end in .html or .svg: a picture is written with --inspect", out.display());
    Ok(())
}

/// Asks question `number`, counted from 1, and draws what came of it.
///
/// # Errors
/// When there is no such question, the tiles cannot be read, or the picture cannot be written.
pub async fn run(
    drive: &Drive,
    tiles: &Path,
    plan: &QuestionPlan,
    number: usize,
    out: &Path,
) -> anyhow::Result<String> {
    check(out)?;
    let asked = DriveQuestions::of(drive, plan)?;
    let count = asked.count();
    ensure!((1..=count).contains(&number), "the drive asks {count} questions; there is no number {number}");
    let question = &asked.questions[number - 1];
    let localizer = OfflineLocalizer::open(tiles)?;
    let answer = localizer.answer(&question.question).await;
    let picture = drawn(&localizer, question, number, &answer)?;
    let told = picture.title.clone();
    let html = out.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("html"));
    let text = if html { picture.html() } else { picture.svg() };
    std::fs::write(out, text).with_context(|| format!("writing {}", out.display()))?;
    Ok(told)
}

fn drawn(
    localizer: &OfflineLocalizer,
    asked: &TruthQuestion,
    number: usize,
    answer: &Result<LocalizeResponse, CallError>,
) -> anyhow::Result<Picture> {
    let request = &asked.question.request;
    let prior = request.prior.as_ref().and_then(|prior| prior.pose).context("the question has no prior")?;
    let at = LatLon { lat_deg: prior.latitude_deg, lon_deg: prior.longitude_deg };
    let grid = Grid::of(at)?;
    let prior = grid.pose_from_geodetic(at, prior.yaw_rad)?;
    let (pose, verdict, reason) = match answer {
        Ok(answer) => {
            let correction = answer.correction.unwrap_or_default();
            (moved(&prior, &correction), answer.status().as_str_name(), answer.status_reason.clone())
        }
        Err(refused) => (prior, "REFUSED", refused.to_string()),
    };
    let mut markers = vec![Marker::pose("prior", "#777777", prior)];
    if let Ok(answer) = &answer {
        for other in &answer.alternatives {
            let name = format!("also possible, score {:.2}", other.relative_score);
            markers.push(Marker::pose(
                &name,
                "#e69f00",
                moved(&prior, &other.correction.unwrap_or_default()),
            ));
        }
        if let Some(rival) = answer.diagnostics.as_ref().and_then(|diagnostics| diagnostics.rival) {
            markers.push(Marker::pose("strongest rival", "#d55e00", moved(&prior, &rival)));
        }
        let mut marker = Marker::pose("answer", "#0072b2", pose);
        marker.ellipse_m =
            answer.protection.filter(|levels| levels.valid).map(|levels| [levels.along_m, levels.cross_m]);
        markers.push(marker);
    }
    let truth = grid.pose_from_geodetic(asked.truth.at, asked.truth.yaw_rad)?;
    markers.push(Marker::pose("known pose", "#009e73", truth));
    let centre = MapPoint::new(pose.x_m, pose.y_m);
    Ok(Picture {
        title: format!("question {number}: {}", verdict.trim_start_matches("FIX_STATUS_")),
        facts: facts(&reason, answer.as_ref().ok(), &pose, &truth),
        centre,
        half_m: HALF_M,
        map: localizer.cells(grid.zone(), centre, HALF_M)?,
        batch: batch_points(request)?.into_iter().map(|point| pose.transform(point)).collect(),
        markers,
    })
}

/// The prior, corrected on the grid.
fn moved(prior: &Pose2, by: &RelativePose) -> Pose2 {
    Pose2::new(prior.x_m + by.x_m, prior.y_m + by.y_m, prior.yaw_rad + by.yaw_rad)
}

/// What is written beside the picture.
fn facts(
    reason: &str,
    answer: Option<&LocalizeResponse>,
    pose: &Pose2,
    truth: &Pose2,
) -> Vec<(&'static str, String)> {
    let mut facts = vec![("verdict", reason.to_owned())];
    let Some(answer) = answer else { return facts };
    facts.push(("off the known pose", format!("{:.2} m", pose.distance_m(truth))));
    if let Some(levels) = &answer.protection {
        let [along, cross, yaw] = [levels.along_m, levels.cross_m, levels.yaw_rad.to_degrees()];
        let valid = if levels.valid { "" } else { " (not valid)" };
        facts.push((
            "protection level",
            format!("{along:.2} m along, {cross:.2} m across, {yaw:.2} deg{valid}"),
        ));
    }
    if let Some(of) = &answer.diagnostics {
        facts.push(("margin, surprise", format!("{:.1}, {:.1} nats", of.margin, of.surprise)));
        facts.push(("matched", format!("{:.0} % of {} blocks", 1e2 * of.matched_fraction, of.batch_blocks)));
        facts.push(("detections", format!("{} used of {} sent", of.detections_used, of.detections_sent)));
        facts.push(("batch", format!("{:.1} s, {:.1} m travelled", of.batch_duration_s, of.travelled_m)));
    }
    if let Some(map) = &answer.map {
        facts.push(("map", format!("covers {:.0} % of what was seen", 1e2 * map.coverage)));
    }
    facts
}

/// The detections of a request in the body's frame at its reference time.
fn batch_points(request: &LocalizeRequest) -> anyhow::Result<Vec<[f64; 2]>> {
    let Some(Batch { mounts, scans: Some(scans), odometry: Some(odometry), .. }) = &request.batch else {
        return Ok(Vec::new());
    };
    let pose = |i: usize| Pose2::new(odometry.x_m[i], odometry.y_m[i], odometry.yaw_rad[i]);
    let way = Trajectory::new(odometry.time_offset_us.iter().enumerate().map(|(i, time)| (*time, pose(i))))?;
    let (mut points, mut row) = (Vec::new(), 0);
    let now = way.at(0).context("the odometry does not reach the batch's time")?;
    for (i, count) in scans.detection_count.iter().enumerate() {
        let rows = row..row + *count as usize;
        row = rows.end;
        let Some(then) = way.at(scans.time_offset_us[i]) else { continue };
        let Some(mount) = mounts.get(scans.sensor[i] as usize) else { continue };
        let mount = Pose2::new(mount.x_m.into(), mount.y_m.into(), mount.yaw_rad.into());
        let body = now.between(&then);
        points.extend(rows.map(|row| {
            let up = f64::from(scans.elevation_rad.get(row).copied().unwrap_or(0.0));
            let (range, azimuth) =
                (f64::from(scans.range_m[row]) * up.cos(), f64::from(scans.azimuth_rad[row]));
            body.transform(mount.transform([range * azimuth.cos(), range * azimuth.sin()]))
        }));
    }
    Ok(points)
}
