//! SIGTERM and SIGHUP, in every phase of the service: it ends soon, with success, and what was acknowledged is there.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use echofix_tests::service::Service;
use echofix_tests::traffic::{Acknowledgements, Uploads};
use echofix_tests::{grpc, http, mapping, town, until};
use tonic::Code;

/// What the configuration allows requests in flight, and what the end may take beyond it: two seconds, and some for a machine that
/// is busy.
const GRACE: Duration = Duration::from_secs(3);
const BEYOND: Duration = Duration::from_secs(4);

fn started() -> Service {
    Service::start_with(&["limits.shutdown_s=3"])
}

/// How many times each phase is ended; more by the environment.
fn rounds() -> u32 {
    std::env::var("ECHOFIX_ENDINGS").map_or(1, |rounds| rounds.parse().expect("ECHOFIX_ENDINGS is a number"))
}

/// Signals the service and waits for its end, which must be soon and a success.
fn ends(service: &mut Service, signal: &str, phase: &str) -> Duration {
    let began = Instant::now();
    service.signal(signal);
    let status = service.ended();
    let took = began.elapsed();
    assert!(status.success() && took < GRACE + BEYOND, "{phase}, {signal}: {status:?} after {took:?}");
    took
}

/// Catches: a service that is deaf until its store is open, or is killed.
#[tokio::test(flavor = "multi_thread")]
async fn while_starting_and_at_rest() {
    let uploads = Arc::new(Uploads::new(town::seed()));
    let mut service = started();
    let mut client = grpc::mapping(&service).await;
    for number in 0..40 {
        mapping::send(&mut client, &uploads.parts(number)).await.expect("it is taken");
    }
    service.kill();
    for round in 0..4 * rounds() {
        for signal in ["TERM", hang_up(), "INT"] {
            // From the very start of the process until it serves.
            service.launch_again();
            service.wait_until_it_hears();
            tokio::time::sleep(Duration::from_millis(u64::from(25 * (round % 8)))).await;
            ends(&mut service, signal, "starting");
        }
    }
    service.start_again();
    let took = ends(&mut service, "TERM", "at rest");
    assert!(took < GRACE + Duration::from_secs(1), "nothing was in flight, and it took {took:?}");
}

/// SIGHUP; SIGTERM where the tests were started with `nohup`, for then a service rightly hears no SIGHUP.
fn hang_up() -> &'static str {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    if ignored & 1 == 0 {
        return "HUP";
    }
    eprintln!("NOT RUN: SIGHUP, which is ignored here (nohup); SIGTERM in its place");
    "TERM"
}

/// Catches: a drain that waits until all that was uploaded is folded, and folding that is lost by it.
#[tokio::test(flavor = "multi_thread")]
async fn while_folding_and_building() {
    let uploads = Arc::new(Uploads::new(town::seed()));
    let mut service = started();
    let mut known = Acknowledgements::default();
    for round in 0..rounds() {
        let from = uploads.fresh();
        let folding = async |service: &mut Service| {
            until("much waits to be folded", Duration::from_mins(1), async || {
                let map = http::get(&format!("{}/api/v1/map", service.http)).json();
                (map["journaled"].as_u64()? > map["epoch"].as_u64()? + 20 || round > 0).then_some(())
            })
            .await;
            ends(service, if round % 2 == 0 { "TERM" } else { hang_up() }, "folding");
        };
        known.until_gone(&uploads, &mut service, folding).await;
        service.start_again();
        assert!(known.judge(&uploads, &service, from).await.is_empty(), "an acknowledged upload is lost");
    }
    ends(&mut service, "TERM", "at rest");
    // Another policy: the map is made anew at the start.
    service.set(&["mapping.half_life_days=90"]);
    service.launch_again();
    service.wait_until_it_hears();
    tokio::time::sleep(Duration::from_millis(300)).await;
    ends(&mut service, "TERM", "building");
    service.start_again();
}

/// Catches: streams that are open and cost all of the grace, and vehicles that are not told.
#[tokio::test(flavor = "multi_thread")]
async fn open_streams_end_at_once_and_are_told() {
    let mut service = started();
    let mut client = LocalizationServiceClient::new(grpc::connect(&service).await);
    let mut streams = Vec::new();
    for _ in 0..4 {
        streams.push(client.localize_stream(tokio_stream::pending()).await.expect("it is open").into_inner());
    }
    let silent = TcpStream::connect(service.grpc.trim_start_matches("http://")).expect("it connects");
    let mut events = TcpStream::connect(service.http.trim_start_matches("http://")).expect("it connects");
    events.write_all(b"GET /api/v1/events HTTP/1.1\r\nhost: localhost\r\n\r\n").expect("it is sent");
    assert!(events.read(&mut [0; 64]).is_ok_and(|read| read > 0), "events come");
    let took = ends(&mut service, "TERM", "streams are open");
    assert!(took < GRACE, "they cost {took:?}");
    for mut stream in streams {
        let told = stream.message().await.expect_err("the stream ends with a reason");
        assert_eq!(told.code(), Code::Unavailable, "{told:?}");
        assert!(told.message().contains("ends"), "{told:?}");
    }
    drop(silent);
}

/// Catches: an end that waits for whoever looks at the past, or takes a backup slowly.
#[tokio::test(flavor = "multi_thread")]
async fn while_operators_verify_and_back_up() {
    let uploads = Arc::new(Uploads::new(town::seed()));
    let mut service = started();
    let mut client = grpc::mapping(&service).await;
    for number in 0..60 {
        mapping::send(&mut client, &uploads.parts(number)).await.expect("it is taken");
    }
    mapping::folded(&service).await;
    for _ in 0..rounds() {
        let address = service.http.trim_start_matches("http://").to_owned();
        let ask = |head: &str| {
            let mut stream = TcpStream::connect(&address).expect("it connects");
            stream
                .write_all(
                    format!("{head} HTTP/1.1\r\nhost: localhost\r\ncontent-length: 0\r\n\r\n").as_bytes(),
                )
                .expect("it is sent");
            stream
        };
        // Asked for, and never read.
        let _asked = [
            ask("POST /api/v1/map/verify?replay=true"),
            ask("GET /api/v1/map/backup"),
            ask("GET /api/v1/map/export"),
        ];
        tokio::time::sleep(Duration::from_millis(200)).await;
        ends(&mut service, "TERM", "verifying");
        service.start_again();
    }
}
