//! Asking over a stream that carries only what is new: the same answers for fewer bytes.

use echofix_client::service::ServiceAddress;
use echofix_client::{Localizer, LocalizerOptions};
use echofix_harness::questions::{DriveQuestions, QuestionPlan};
use echofix_proto::v1::LocalizeResponse;
use echofix_tests::world::World;
use prost::Message;

/// An answer without how long it took.
fn content(mut answer: LocalizeResponse) -> LocalizeResponse {
    if let Some(diagnostics) = &mut answer.diagnostics {
        (diagnostics.queued_ms, diagnostics.window_ms, diagnostics.align_ms) = (0.0, 0.0, 0.0);
    }
    answer
}

/// Catches a batch that is put together otherwise than the vehicle has it, and deltas that are hardly smaller than what they
/// stand for. What vehicles send in an hour is printed (`--nocapture`).
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_gets_the_same_answers_for_a_quarter_of_the_bytes() {
    let world = World::mapped().await;
    let asked = DriveQuestions::of(&world.visit(420.0), &QuestionPlan::every(1.0, world.seed))
        .expect("the drive makes questions");
    let service = ServiceAddress::at(&world.service.grpc).endpoint().expect("the address is one");
    let localizer = Localizer::new(service, LocalizerOptions::default());
    let (mut stream, mut whole_bytes) = (localizer.stream(), 0_u64);
    for index in 0..asked.count() {
        let question = asked.question(index);
        whole_bytes += question.request.encoded_len() as u64 + 5;
        let alone = localizer.ask(question).await.expect("the question has an answer");
        let streamed = stream.ask(question).await.expect("the question has an answer");
        assert_eq!(content(streamed), content(alone), "seed {}, question {index}", world.seed);
    }
    let traffic = stream.traffic();
    let an_hour = |bytes: u64| bytes as f64 * 3600.0 / 1e6 / asked.count() as f64;
    eprintln!(
        "{} questions with batches of 5 s, one a second: {:.1} MB an hour whole, {:.1} MB as deltas ({} whole)",
        asked.count(),
        an_hour(whole_bytes),
        an_hour(traffic.bytes),
        traffic.whole
    );
    assert_eq!(traffic.whole, 1, "only the first is whole: {traffic:?}");
    // The first question is whole, and the drive is short: in the long run it does not count.
    let first = asked.question(0).request.encoded_len() as u64;
    assert!((traffic.bytes - first) * 4 <= whole_bytes - first, "{traffic:?} of {whole_bytes}");
}
