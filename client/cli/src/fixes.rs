//! A drive asks where it is, and the answers are compared with the truth.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, bail};
use echofix_client::drivelog::{Event, replay};
use echofix_client::refusal::CallError;
use echofix_client::vehicle::{Config, NotReady, Question, Vehicle};
use echofix_client::Localizer;
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::geo::Grid;
use echofix_core::odometry::Trajectory;
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_proto::v1::{FixStatus, LocalizeResponse};
use indicatif::ProgressBar;
use prost::Message;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::statistics::Percentiles;

/// When to ask, and what to pretend to know.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Seconds between questions; 0 asks at every scan.
    pub every_s: f64,
    /// Seconds of scans a batch spans.
    pub batch_s: f64,
    /// Random priors a batch.
    pub priors: usize,
    /// One-sigma error of the priors' position along each axis, metres.
    pub sigma_position_m: f64,
    /// One-sigma error of the priors' heading, radians.
    pub sigma_yaw_rad: f64,
    /// Seed of the priors' errors.
    pub seed: u64,
    /// Seconds of scans that must have come before the first question.
    pub warm_up_s: f64,
    /// Questions under way at once.
    pub at_once: usize,
}

/// One question and what came of it.
#[derive(Debug, Clone, Serialize)]
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

/// Figures of many fixes.
#[derive(Debug, Clone, Serialize)]
pub struct Summary {
    /// Questions asked.
    pub asked: usize,
    /// Times at which the vehicle had nothing to ask with, by the reason.
    pub not_asked: BTreeMap<String, usize>,
    /// What came of the questions.
    pub outcomes: BTreeMap<String, usize>,
    /// Share of the questions with a usable answer.
    pub usable_share: f64,
    /// Horizontal error of usable answers, metres.
    pub error_m: Option<Percentiles>,
    /// Heading error of usable answers, degrees.
    pub error_yaw_deg: Option<Percentiles>,
    /// Horizontal error of all answers, usable or not, metres.
    pub error_all_m: Option<Percentiles>,
    /// Heading error of all answers, usable or not, degrees.
    pub error_yaw_all_deg: Option<Percentiles>,
    /// Usable answers whose error exceeded a valid protection level.
    pub beyond_protection: usize,
    /// Milliseconds the service computed a fix.
    pub server_ms: Option<Percentiles>,
    /// Kilobytes of a request.
    pub request_kb: Option<Percentiles>,
}

/// All fixes of a drive.
#[derive(Debug, Clone, Default)]
pub struct Replay {
    /// In order of time.
    pub fixes: Vec<Fix>,
    /// Times at which the vehicle had nothing to ask with, by the reason.
    pub not_asked: BTreeMap<String, usize>,
}

impl Replay {
    /// Its figures.
    pub fn summary(&self) -> Summary {
        let usable = || self.fixes.iter().filter(|f| f.usable);
        let mut outcomes = BTreeMap::new();
        for fix in &self.fixes {
            *outcomes.entry(fix.outcome.clone()).or_default() += 1;
        }
        let yaw = |f: &Fix| f.error_yaw_deg.map(f64::abs);
        let beyond = |f: &&Fix| {
            let exceeds = |error: Option<f64>, level: Option<f64>| {
                error.zip(level).is_some_and(|(error, level)| error.abs() > level)
            };
            exceeds(f.error_along_m, f.protection_along_m) || exceeds(f.error_cross_m, f.protection_cross_m)
        };
        Summary {
            asked: self.fixes.len(),
            not_asked: self.not_asked.clone(),
            outcomes,
            usable_share: usable().count() as f64 / self.fixes.len().max(1) as f64,
            error_m: Percentiles::of(usable().filter_map(Fix::error_m)),
            error_yaw_deg: Percentiles::of(usable().filter_map(yaw)),
            error_all_m: Percentiles::of(self.fixes.iter().filter_map(Fix::error_m)),
            error_yaw_all_deg: Percentiles::of(self.fixes.iter().filter_map(yaw)),
            beyond_protection: usable().filter(beyond).count(),
            server_ms: Percentiles::of(self.fixes.iter().filter_map(|f| f.server_ms)),
            request_kb: Percentiles::of(self.fixes.iter().map(|f| f.request_bytes as f64 / 1e3)),
        }
    }
}

/// Drives the log through a [`Vehicle`] and asks as planned, each time from priors drawn around the
/// truth.
///
/// # Errors
/// When the truth is not known, the log does not fit together, or the service is out of reach.
pub async fn ask(drive: &Drive, localizer: &Localizer, plan: &Plan, bar: &ProgressBar) -> anyhow::Result<Replay> {
    let truth = if drive.truth.is_empty() { &drive.reference } else { &drive.truth };
    let Some(truth) = Truth::new(truth)? else {
        bail!("the drive of `{}` has neither truth nor reference poses to draw priors around", drive.vehicle);
    };
    let (questions, not_asked) = questions(drive, &truth, plan)?;
    if questions.is_empty() {
        bail!("the drive of `{}` holds no batch to ask with: {not_asked:?}", drive.vehicle);
    }
    bar.inc_length(questions.len() as u64);
    let places = Arc::new(Semaphore::new(plan.at_once));
    let mut asked = JoinSet::new();
    for (index, (question, true_pose)) in questions.into_iter().enumerate() {
        let (localizer, places) = (localizer.clone(), Arc::clone(&places));
        asked.spawn(async move {
            let _place = places.acquire_owned().await;
            let from = Instant::now();
            let answer = localizer.ask(&question).await;
            (index, question, true_pose, answer, from.elapsed().as_secs_f64() * 1e3)
        });
    }
    let mut fixes = BTreeMap::new();
    while let Some(done) = asked.join_next().await {
        let (index, question, true_pose, answer, round_trip_ms) = done.context("a question broke down")?;
        if let Err(CallError::Unavailable { .. }) = &answer {
            answer.context("the service is out of reach")?;
            continue;
        }
        fixes.insert(index, record(&question, &true_pose, answer, round_trip_ms));
        bar.inc(1);
    }
    Ok(Replay { fixes: fixes.into_values().collect(), not_asked })
}

type Questions = (Vec<(Question, GeoPose)>, BTreeMap<String, usize>);

/// The questions of a drive, with the truth at their times.
fn questions(drive: &Drive, truth: &Truth, plan: &Plan) -> anyhow::Result<Questions> {
    let config = Config { window_s: plan.batch_s, ..Config::default() };
    let mut vehicle = Vehicle::new(config, drive.mounts.clone());
    let mut rng = ChaCha8Rng::seed_from_u64(plan.seed);
    let mut questions = Vec::new();
    let mut not_asked = BTreeMap::new();
    let mut next_us = drive.scans.first().map_or(0, |s| s.time_us + (plan.warm_up_s * 1e6) as i64);
    for event in replay(drive) {
        match event {
            Event::Odometry(time_us, pose) => vehicle.push_odometry(time_us, pose)?,
            Event::Scan(scan) => vehicle.push_scan(scan.clone())?,
            Event::Reference(_) | Event::Truth(_) => {}
        }
        let Event::Odometry(now_us, _) = event else { continue };
        let Some(true_now) = truth.at(now_us) else { continue };
        if now_us < next_us {
            continue;
        }
        vehicle.forget_position();
        vehicle.push_pose(true_now)?;
        match vehicle.question() {
            Ok(question) => {
                if questions.last().is_some_and(|(q, _): &(Question, _)| q.time_us() >= question.time_us()) {
                    continue; // No newer scan yet.
                }
                let Some(true_pose) = truth.at(question.time_us()) else { continue };
                for _ in 0..plan.priors {
                    questions.push((with_prior(&question, truth, &true_pose, plan, &mut rng)?, true_pose));
                }
            }
            Err(reason) => *not_asked.entry(word(&reason).to_owned()).or_default() += 1,
        }
        next_us = now_us + (plan.every_s * 1e6) as i64;
    }
    Ok((questions, not_asked))
}

fn word(reason: &NotReady) -> &'static str {
    match reason {
        NotReady::NoOdometry => "no odometry",
        NotReady::TooSlow { .. } => "too slow",
        NotReady::NoDetections => "no detections",
        NotReady::NoPrior => "no prior",
        NotReady::OffTheMap(_) => "off the map",
    }
}

/// The question with a prior drawn around the truth (paper, Sec. "Test procedure").
fn with_prior(
    question: &Question,
    truth: &Truth,
    true_pose: &GeoPose,
    plan: &Plan,
    rng: &mut ChaCha8Rng,
) -> anyhow::Result<Question> {
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    let exact = truth.grid.pose_from_geodetic(true_pose.at, true_pose.yaw_rad)?;
    let drawn = Pose2::new(
        exact.x_m + plan.sigma_position_m * normal(),
        exact.y_m + plan.sigma_position_m * normal(),
        exact.yaw_rad + plan.sigma_yaw_rad * normal(),
    );
    let (at, yaw_rad) = truth.grid.pose_to_geodetic(&drawn)?;
    let mut question = question.clone();
    let prior = question.request.prior.get_or_insert_default();
    let pose = prior.pose.get_or_insert_default();
    (pose.latitude_deg, pose.longitude_deg, pose.yaw_rad) = (at.lat_deg, at.lon_deg, yaw_rad);
    (prior.sigma_position_m, prior.sigma_yaw_rad) = (plan.sigma_position_m, plan.sigma_yaw_rad);
    Ok(question)
}

fn record(
    question: &Question,
    true_pose: &GeoPose,
    answer: Result<LocalizeResponse, CallError>,
    round_trip_ms: f64,
) -> Fix {
    let mut fix = Fix {
        time_us: question.time_us(),
        outcome: String::new(),
        detail: String::new(),
        usable: false,
        latitude_deg: None,
        longitude_deg: None,
        yaw_rad: None,
        error_along_m: None,
        error_cross_m: None,
        error_yaw_deg: None,
        protection_along_m: None,
        protection_cross_m: None,
        matched_fraction: None,
        detections_used: None,
        server_ms: None,
        round_trip_ms,
        request_bytes: question.request.encoded_len(),
    };
    match answer {
        Ok(answer) => fill(&mut fix, &answer, true_pose),
        Err(CallError::Refused { reason, message }) => {
            (fix.outcome, fix.detail) = (reason.reason().to_owned(), message);
        }
        Err(error) => {
            let text = error.to_string();
            (fix.outcome, fix.detail) = (text.split([':', ';', ',']).next().unwrap_or("failed").to_owned(), text);
        }
    }
    fix
}

fn fill(fix: &mut Fix, answer: &LocalizeResponse, true_pose: &GeoPose) {
    let status = answer.status();
    let name = status.as_str_name();
    fix.outcome = name.strip_prefix("FIX_STATUS_").unwrap_or(name).to_owned();
    fix.detail.clone_from(&answer.status_reason);
    fix.usable = status == FixStatus::Usable;
    if let Some(pose) = &answer.pose {
        let [along, cross, yaw] = error(pose, true_pose);
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

/// Error along and across the true heading, metres, and of the heading, radians. Over a few metres
/// the globe is a plane.
fn error(pose: &echofix_proto::v1::GeodeticPose, truth: &GeoPose) -> [f64; 3] {
    const METRES_PER_DEGREE: f64 = 111_320.0;
    let shrink = truth.at.lat_deg.to_radians().cos();
    let east = (pose.longitude_deg - truth.at.lon_deg) * METRES_PER_DEGREE * shrink;
    let north = (pose.latitude_deg - truth.at.lat_deg) * METRES_PER_DEGREE;
    let (s, c) = truth.yaw_rad.sin_cos();
    [c * east + s * north, c * north - s * east, wrap_angle(pose.yaw_rad - truth.yaw_rad)]
}

/// Known poses, interpolated on the grid.
struct Truth {
    grid: Grid,
    poses: Trajectory,
    sigmas: (f64, f64),
}

impl Truth {
    fn new(poses: &[GeoPose]) -> anyhow::Result<Option<Self>> {
        let Some(first) = poses.first() else { return Ok(None) };
        let grid = Grid::of(first.at)?;
        let on_grid = |p: &GeoPose| Ok((p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad)?));
        let placed: Vec<_> = poses.iter().map(on_grid).collect::<anyhow::Result<_>>()?;
        let sigmas = (first.sigma_position_m, first.sigma_yaw_rad);
        Ok(Some(Self { poses: Trajectory::new(placed)?, grid, sigmas }))
    }

    fn at(&self, time_us: i64) -> Option<GeoPose> {
        let pose = self.poses.at(time_us)?;
        let (at, yaw_rad) = self.grid.pose_to_geodetic(&pose).ok()?;
        let (sigma_position_m, sigma_yaw_rad) = self.sigmas;
        Some(GeoPose { time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::geo::LatLon;
    use echofix_proto::v1::GeodeticPose;

    #[test]
    fn errors_are_split_along_and_across_the_heading() {
        let at = LatLon { lat_deg: 60.0, lon_deg: 10.0 };
        let truth = GeoPose { at, yaw_rad: std::f64::consts::FRAC_PI_2, ..GeoPose::default() };
        // One metre north of a vehicle heading north, half a metre east.
        let pose = GeodeticPose {
            latitude_deg: 60.0 + 1.0 / 111_320.0,
            longitude_deg: 10.0 + 0.5 / 55_660.0,
            yaw_rad: truth.yaw_rad + 0.01,
        };
        let [along, cross, yaw] = error(&pose, &truth);
        assert!((along - 1.0).abs() < 1e-6 && (cross + 0.5).abs() < 1e-6 && (yaw - 0.01).abs() < 1e-12);
    }
}
