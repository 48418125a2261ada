//! What a drive asks, and the priors it pretends to have.

use std::collections::BTreeMap;

use echofix_client::drivelog::{DriveEvent, replay};
use echofix_client::vehicle::{LocalizationQuestion, NotReady, Vehicle, VehicleConfig};
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::pose::Pose2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::Plan;
use super::truth::Truth;
use crate::contribute::LeftOut;

/// What a drive asks, with the truth at those times.
pub(super) struct Questions {
    pub(super) asked: Vec<(LocalizationQuestion, GeoPose)>,
    pub(super) not_asked: BTreeMap<String, usize>,
    pub(super) left_out: LeftOut,
}

/// The questions of a drive, with the truth at their times.
pub(super) fn questions(drive: &Drive, truth: &Truth, plan: &Plan) -> anyhow::Result<Questions> {
    let config = VehicleConfig { window_s: plan.batch_s, ..VehicleConfig::default() };
    let mut vehicle = Vehicle::new(config, drive.mounts.clone());
    let mut rng = ChaCha8Rng::seed_from_u64(plan.seed);
    let mut questions = Vec::new();
    let mut not_asked = BTreeMap::new();
    let mut next_us = drive.scans.first().map_or(0, |s| s.time_us + (plan.warm_up_s * 1e6) as i64);
    for event in replay(drive) {
        match event {
            DriveEvent::Odometry(time_us, pose) => vehicle.push_odometry(time_us, pose)?,
            DriveEvent::Scan(scan) => vehicle.push_scan(scan.clone())?,
            DriveEvent::Reference(_) | DriveEvent::Truth(_) => {}
        }
        let DriveEvent::Odometry(now_us, _) = event else { continue };
        let Some(true_now) = truth.at(now_us) else { continue };
        if now_us < next_us {
            continue;
        }
        vehicle.forget_position();
        vehicle.push_pose(true_now)?;
        match vehicle.question() {
            Ok(question) => {
                if questions
                    .last()
                    .is_some_and(|(q, _): &(LocalizationQuestion, _)| q.time_us() >= question.time_us())
                {
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
    Ok(Questions { asked: questions, not_asked, left_out: vehicle.dropped().into() })
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
    question: &LocalizationQuestion,
    truth: &Truth,
    true_pose: &GeoPose,
    plan: &Plan,
    rng: &mut ChaCha8Rng,
) -> anyhow::Result<LocalizationQuestion> {
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
