//! What Prometheus itself says of the metrics and of the alert rules. Needs `promtool`, so it is ignored by default; `.ci/run` runs it
//! where there is one.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use echofix_tests::http::{get_with, metric};
use echofix_tests::service::Service;
use echofix_tests::world::World;
use echofix_tests::{asking, grpc, http};

/// `promtool` with arguments, which reads a text.
fn promtool(arguments: &[&str], input: &str) -> Output {
    let program = std::env::var("PROMTOOL").unwrap_or_else(|_| "promtool".to_owned());
    let mut tool = Command::new(program);
    tool.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut tool = tool.spawn().expect("promtool can be run: apt-get install prometheus, or set PROMTOOL");
    let mut stdin = tool.stdin.take().expect("it is piped");
    stdin.write_all(input.as_bytes()).expect("it reads");
    drop(stdin);
    tool.wait_with_output().expect("it ends")
}

/// Fails the test unless it found nothing at all: a warning ends with code 0 or 3.
fn clean(tool: &Output) {
    let said = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(tool.status.success() && tool.stderr.is_empty(), "{}{}", said(&tool.stdout), said(&tool.stderr));
}

/// Catches: metrics that the older text cannot be read from, or that a linter finds fault with, once everything was counted.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs promtool (apt-get install prometheus)"]
async fn promtool_finds_no_fault_with_the_metrics() {
    let world = World::mapped_with(Service::start_with(&["locating.confirm_share=1.0"])).await;
    let mut client = grpc::localizing(&world.service).await;
    for question in world.questions(150.0, 4.0) {
        let _ = client.localize(question.request).await;
    }
    let nowhere = asking::requests(&world.visit(150.0), 4.0, 1).remove(0).request;
    let nowhere = echofix_proto::v1::LocalizeRequest { prior: None, ..nowhere };
    client.localize(nowhere).await.expect_err("a question without a prior is refused");
    let of = |path: &str| format!("{}{path}", world.service.http);
    assert_eq!(http::get(&of("/nowhere")).status, 404);
    http::get(&of("/api/v1/map/backup"));

    let text = get_with(&of("/metrics"), &[("accept", "text/plain;version=0.0.4")]);
    assert_eq!(text.header("content-type"), Some("text/plain; version=0.0.4; charset=utf-8"));
    let text = text.text();
    assert!(
        metric(text, "echofix_last_backup_timestamp_seconds") > 0.0 && text.contains("_bucket{"),
        "{text}"
    );
    clean(&promtool(&["check", "metrics"], text));
    // The tool is no rubber stamp.
    let faulty = promtool(&["check", "metrics"], "# TYPE echofix_fixes counter\nechofix_fixes 1\n");
    assert!(!faulty.status.success() && !faulty.stderr.is_empty());
}

/// Catches: alert rules that Prometheus does not load.
#[test]
#[ignore = "needs promtool (apt-get install prometheus)"]
fn promtool_loads_the_alert_rules() {
    let rules = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docker/monitoring/echofix-alerts.yaml");
    clean(&promtool(&["check", "rules", rules.to_str().expect("the path is Unicode")], ""));
}
