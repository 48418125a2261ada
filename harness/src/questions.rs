//! What a drive asks, from priors drawn around the truth.

use std::collections::BTreeMap;

use anyhow::{Context, bail};
use echofix_client::drivelog::{DriveEvent, replay};
use echofix_client::vehicle::{LocalizationQuestion, NotReady, Vehicle, VehicleConfig};
use echofix_core::convention::{Finding, in_words};
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::gate::{Gate, MAX_RANGE_M};
use echofix_core::odometry::OdometryQuality;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::flaws::DriveFlaws;
use crate::prior::PriorSigma;
use crate::recording::LeftOut;
use crate::truth::{Truth, as_prior};

/// When to ask, and from which priors.
#[derive(Debug, Clone)]
pub struct QuestionPlan {
    /// Seconds between questions; 0 asks at every scan.
    pub every_s: f64,
    /// Seconds of scans a batch spans.
    pub batch_s: f64,
    /// Seconds of scans that must have come before the first question.
    pub warm_up_s: f64,
    /// Random priors a batch.
    pub priors: usize,
    /// Their error.
    pub sigma: PriorSigma,
    /// Seed of their errors.
    pub seed: u64,
    /// Farther detections are dropped on the vehicle, metres.
    pub max_range_m: f64,
    /// How good the vehicle's odometry is.
    pub odometry: OdometryQuality,
}

impl QuestionPlan {
    /// Batches of 5 s and one of the paper's priors each.
    #[must_use]
    pub fn every(every_s: f64, seed: u64) -> Self {
        let (sigma, max_range_m) = (PriorSigma::PAPER, MAX_RANGE_M);
        let odometry = OdometryQuality::default();
        Self { every_s, batch_s: 5.0, warm_up_s: 5.0, priors: 1, sigma, seed, max_range_m, odometry }
    }
}

/// A question, and the pose that would be the right answer.
#[derive(Debug, Clone)]
pub struct TruthQuestion {
    /// The question.
    pub question: LocalizationQuestion,
    /// Where the vehicle truly was at its time.
    pub truth: GeoPose,
}

/// The questions of a drive.
pub struct DriveQuestions {
    /// In order of time, at least one.
    pub questions: Vec<TruthQuestion>,
    /// Times at which the vehicle had nothing to ask with, by the reason.
    pub not_asked: BTreeMap<String, usize>,
    /// Detections that the vehicle's gates left out.
    pub left_out: LeftOut,
    /// What seems to be in another convention than the contract's.
    pub findings: Vec<Finding>,
    /// Measurements that the vehicle did not take.
    pub flaws: DriveFlaws,
    /// Where the vehicle truly was.
    pub truth: Truth,
}

impl DriveQuestions {
    /// Drives the log through a [`Vehicle`] and notes what it would ask as planned, each time from priors drawn around
    /// the truth.
    ///
    /// # Errors
    /// When the truth is not known, the log does not fit together, or there is nothing to ask with.
    pub fn of(drive: &Drive, plan: &QuestionPlan) -> anyhow::Result<Self> {
        let truth = Truth::of(drive)?.with_context(|| {
            format!(
                "the drive of `{}` has neither truth nor reference poses to draw priors around",
                drive.vehicle
            )
        })?;
        let gate = Gate { max_range_m: plan.max_range_m, ..Gate::default() };
        let config = VehicleConfig {
            window_s: plan.batch_s,
            gate,
            odometry_quality: plan.odometry,
            ..VehicleConfig::default()
        };
        let mut vehicle = Vehicle::new(config, drive.mounts.clone());
        let mut rng = ChaCha8Rng::seed_from_u64(plan.seed);
        let mut questions: Vec<TruthQuestion> = Vec::new();
        let (mut not_asked, mut flaws) = (BTreeMap::new(), DriveFlaws::default());
        let mut next_us = drive.scans.first().map_or(0, |s| s.time_us + (plan.warm_up_s * 1e6) as i64);
        for event in replay(drive) {
            let (part, taken) = match event {
                DriveEvent::Odometry(time_us, pose) => ("odometry", vehicle.push_odometry(time_us, pose)),
                DriveEvent::Scan(scan) => ("scan", vehicle.push_scan(scan.clone())),
                DriveEvent::Reference(_) | DriveEvent::Truth(_) => continue,
            };
            if let Err(error) = taken {
                flaws.skip(part, event.time_us(), error.reason(), &error);
            }
            let DriveEvent::Odometry(now_us, _) = event else { continue };
            let Some(true_now) = truth.at(now_us).filter(|_| now_us >= next_us) else { continue };
            vehicle.forget_position();
            if let Err(error) = vehicle.push_pose(true_now) {
                flaws.skip("pose", now_us, error.reason(), &error);
                continue;
            }
            match vehicle.question() {
                Ok(question) => {
                    let time_us = question.time_us();
                    if questions.last().is_some_and(|last| last.question.time_us() >= time_us) {
                        continue; // No newer scan yet.
                    }
                    let Some(true_pose) = truth.at(time_us) else { continue };
                    for _ in 0..plan.priors {
                        let rough = truth.drawn_around(&true_pose, plan.sigma, &mut rng)?;
                        let mut question = question.clone();
                        question.request.prior = Some(as_prior(&rough));
                        questions.push(TruthQuestion { question, truth: true_pose });
                    }
                }
                Err(reason) => *not_asked.entry(word(&reason).to_owned()).or_default() += 1,
            }
            next_us = now_us + (plan.every_s * 1e6) as i64;
        }
        let findings = vehicle.findings();
        if questions.is_empty() {
            let (why, told) = (why_nothing(drive, &not_asked), in_words(&findings));
            bail!("the drive of `{}` holds no batch to ask with: {why}. {told}", drive.vehicle);
        }
        Ok(Self { questions, not_asked, left_out: vehicle.dropped().into(), findings, flaws, truth })
    }

    /// Number of questions, at least one.
    pub fn count(&self) -> usize {
        self.questions.len()
    }

    /// A question, in order of time.
    pub fn question(&self, index: usize) -> &LocalizationQuestion {
        &self.questions[index].question
    }

    /// Where the vehicle truly was at the time of a question.
    pub fn true_pose(&self, index: usize) -> &GeoPose {
        &self.questions[index].truth
    }
}

fn word(reason: &NotReady) -> &'static str {
    match reason {
        NotReady::NoOdometry => "no odometry",
        NotReady::TooSlow { .. } => "too slow",
        NotReady::NoDetections => "no detections",
        NotReady::AllMoving(_) => "all moving",
        NotReady::NoPrior => "no prior",
        NotReady::OffTheMap(_) => "off the map",
    }
}
/// Why a drive asks nothing, in words.
fn why_nothing(drive: &Drive, not_asked: &BTreeMap<String, usize>) -> String {
    if drive.odometry.len() < 2 {
        return "its log holds no odometry, by which batches are organised".to_owned();
    }
    if not_asked.is_empty() {
        return "scans, odometry and known poses have no time in common that is long enough".to_owned();
    }
    let reasons: Vec<_> = not_asked.iter().map(|(word, count)| format!("{word} {count}")).collect();
    reasons.join(", ")
}
