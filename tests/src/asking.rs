//! What a drive asks, as requests, and errors against the truth.

use echofix_core::drive::{Drive, GeoPose};
use echofix_harness::prior::PriorSigma;
use echofix_harness::questions::{DriveQuestions, QuestionPlan, TruthQuestion};
use echofix_harness::truth::{AnswerError, Truth};
use echofix_proto::v1::{GeodeticPose, LocalizeRequest};
use rand_chacha::ChaCha8Rng;

/// A request, and the pose that would be the right answer.
#[derive(Debug, Clone)]
pub struct TruthRequest {
    /// The request.
    pub request: LocalizeRequest,
    /// The truth at the time asked for.
    pub truth: GeoPose,
}

/// The requests of a drive, one every so many seconds, from the paper's priors drawn around the truth.
pub fn requests(drive: &Drive, every_s: f64, seed: u64) -> Vec<TruthRequest> {
    let asked = DriveQuestions::of(drive, &QuestionPlan::every(every_s, seed));
    let asked =
        asked.unwrap_or_else(|error| panic!("the drive of `{}` asks nothing: {error}", drive.vehicle));
    let request = |TruthQuestion { question, truth }| TruthRequest { request: question.request, truth };
    asked.questions.into_iter().map(request).collect()
}

/// Where the vehicle of a simulated drive truly was.
pub fn truth(drive: &Drive) -> Truth {
    Truth::of(drive).expect("truth is in order").expect("the drive has truth")
}

/// A pose drawn around another, as GNSS would give it.
pub fn drawn(truth: &Truth, pose: &GeoPose, sigma: PriorSigma, rng: &mut ChaCha8Rng) -> GeoPose {
    truth.drawn_around(pose, sigma, rng).expect("the pose is on the map")
}

/// The error of a pose.
pub fn error(pose: &GeodeticPose, truth: &GeoPose) -> AnswerError {
    AnswerError::of(pose, truth).expect("the poses are on the map")
}

/// The value that a fraction of a sample is not above.
pub fn percentile(sample: impl IntoIterator<Item = f64>, fraction: f64) -> f64 {
    echofix_harness::percentiles::percentile(sample, fraction).expect("a percentile of something")
}
