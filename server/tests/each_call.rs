//! What holds for each call and route: bodies that dribble, messages that unpack to more than is taken, callers that go away, and
//! questions that are refused before they are received.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod common;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use axum::http::{Request, Response};
use common::{TestServer, drive};
use echofix_proto::v1::{GeodeticBox, GetCoverageRequest, GetTilesRequest};
use prost::Message;
use tokio::task::JoinSet;
use tokio_stream::{Stream, StreamExt};
use tonic::body::Body;
use tonic::transport::Channel;
use tonic::{Code, Status};
use tonic_types::StatusExt;
use tower::ServiceExt;
use uuid::Uuid;

const LOCALIZE: &str = "/echofix.v1.LocalizationService/Localize";
const UPLOAD: &str = "/echofix.v1.MappingService/Upload";
const COVERAGE: &str = "/echofix.v1.MapService/GetCoverage";
const TILES: &str = "/echofix.v1.MapService/GetTiles";
const HEALTH: &str = "/grpc.health.v1.Health/Check";
/// The calls that wait for a body; the two that last as long as their caller wants are bounded otherwise.
const CALLS: [&str; 5] = [LOCALIZE, UPLOAD, COVERAGE, TILES, HEALTH];
/// The routes that take one.
const ROUTES: [&str; 7] = [
    "/session",
    "/api/v1/map/rollback",
    "/api/v1/map/revoke",
    "/api/v1/map/undo",
    "/api/v1/map/compact",
    "/api/v1/map/settle",
    "/api/v1/map/import",
];

/// A message as gRPC frames it.
fn framed(flag: u8, message: &[u8]) -> Vec<u8> {
    [&[flag][..], &(message.len() as u32).to_be_bytes(), message].concat()
}

/// Calls with a body of pieces.
async fn call(
    channel: Channel,
    (to, path): (SocketAddr, &str),
    encoding: Option<&str>,
    pieces: impl Stream<Item = Vec<u8>> + Send + 'static,
) -> Result<Response<Body>, tonic::transport::Error> {
    let body = axum::body::Body::from_stream(pieces.map(Ok::<_, std::io::Error>));
    let request = Request::post(format!("http://{to}{path}")).header("content-type", "application/grpc");
    let request = request.header("te", "trailers");
    let request = encoding.into_iter().fold(request, |request, name| request.header("grpc-encoding", name));
    channel.oneshot(request.body(Body::new(body)).unwrap()).await
}

/// How a call ended that failed before its first answer.
fn status(answer: &Response<Body>) -> Status {
    Status::from_header_map(answer.headers()).unwrap_or_else(|| Status::ok(""))
}

/// Catches: a call or a route that waits for ever for a body that dribbles.
#[tokio::test(flavor = "multi_thread")]
async fn bodies_that_dribble_are_given_up_wherever_there_is_one() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("limits.stall_s", "1")]).await;
    let grpc = server.grpc;
    let mut waiting = JoinSet::new();
    for path in CALLS {
        let channel = server.channel().await;
        waiting.spawn(async move {
            // A byte at a time, far below the least rate: of a message that is said to have 256.
            let begun = tokio_stream::iter([vec![0, 0, 0, 1, 0]]);
            let more = tokio_stream::iter(std::iter::repeat_with(|| vec![0x0a])).then(|byte| async {
                tokio::time::sleep(Duration::from_millis(300)).await;
                byte
            });
            let answer = call(channel, (grpc, path), None, begun.chain(more)).await.unwrap();
            (path, status(&answer).code() == Code::DeadlineExceeded)
        });
    }
    for path in ROUTES {
        let to = server.http;
        waiting.spawn_blocking(move || {
            let mut stream = TcpStream::connect(to).unwrap();
            let head = format!(
                "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 4096\r\n\r\n{{"
            );
            stream.write_all(head.as_bytes()).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
            let mut told = [0; 12];
            stream.read_exact(&mut told).unwrap();
            // Given up, or not wanted without its kind.
            (path, told.starts_with(b"HTTP/1.1 4"))
        });
    }
    let ended = tokio::time::timeout(Duration::from_mins(1), waiting.join_all()).await;
    for (path, is_given_up) in ended.expect("all of them end") {
        assert!(is_given_up, "{path}");
    }
    server.stop().await;
}

/// Catches: a message of some kilobytes that unpacks to as much memory as its sender likes, in either codec, on any call.
#[tokio::test(flavor = "multi_thread")]
async fn what_unpacks_too_far_is_refused_on_each_call() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let before = held();
    let gzip = packed_by_gzip(64);
    for path in [LOCALIZE, UPLOAD, COVERAGE, TILES] {
        for (name, bomb) in [("gzip", &gzip), ("zstd", &packed_by_zstd(256))] {
            let body = tokio_stream::iter([framed(1, bomb)]);
            let answer = call(server.channel().await, (server.grpc, path), Some(name), body).await.unwrap();
            assert_eq!(status(&answer).code(), Code::InvalidArgument, "{path} {name}: {:?}", status(&answer));
        }
    }
    let taken = held().saturating_sub(before);
    assert!(taken < 128 << 20, "{} MB for {} kB", taken >> 20, gzip.len() >> 10);
    server.stop().await;
}

/// So many mebibytes of nothing, as gzip packs them: one block of repetitions.
fn packed_by_gzip(mebibytes: usize) -> Vec<u8> {
    let mut bits = Bits::default();
    // The last block, with the fixed code; a literal zero, and then repetitions of the 258 bytes before.
    bits.put(1, 1);
    bits.put(1, 2);
    bits.put_code(0b0011_0000, 8);
    for _ in 0..(mebibytes << 20) / 258 {
        bits.put_code(0b1100_0101, 8);
        bits.put_code(0, 5);
    }
    bits.put_code(0, 7);
    // Whether length and checksum match is looked at after all of it was unpacked.
    [&[0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255][..], &bits.bytes, &[0; 8]].concat()
}

/// Bits as deflate orders them.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    count: usize,
}

impl Bits {
    /// The lowest bit first.
    fn put(&mut self, value: u32, bits: usize) {
        for at in 0..bits {
            if self.count.is_multiple_of(8) {
                self.bytes.push(0);
            }
            *self.bytes.last_mut().unwrap() |= ((value >> at & 1) as u8) << (self.count % 8);
            self.count += 1;
        }
    }

    /// A code of Huffman: the highest bit first.
    fn put_code(&mut self, code: u32, bits: usize) {
        (0..bits).rev().for_each(|at| self.put(code >> at & 1, 1));
    }
}

/// The same as zstd packs it: blocks that say which byte is repeated how often.
fn packed_by_zstd(mebibytes: usize) -> Vec<u8> {
    const BLOCK: u32 = 128 << 10;
    // A window of 128 KiB, no size, no checksum.
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0, 7 << 3];
    let blocks = 8 * mebibytes;
    for block in 1..=blocks {
        let head = BLOCK << 3 | 1 << 1 | u32::from(block == blocks);
        frame.extend_from_slice(&head.to_le_bytes()[..3]);
        frame.push(0);
    }
    frame
}

/// Bytes of memory that this process holds.
fn held() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("0 kB");
    line.trim().trim_end_matches(" kB").parse::<usize>().unwrap_or(0) << 10
}

/// Catches: permits and places that stay with callers who went away, at any moment of any call.
#[tokio::test(flavor = "multi_thread")]
async fn callers_that_go_away_leave_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let settings = [
        ("mapping.uploads_at_once", "2"),
        ("limits.reads_at_once", "2"),
        ("locating.threads", "1"),
        ("locating.queue", "1"),
    ];
    let server = TestServer::with(dir.path(), &settings).await;
    server.upload(drive(Uuid::now_v7(), 30.2672, -97.7431)).await.unwrap();
    let area = GeodeticBox { south_deg: 30.2, west_deg: -97.8, north_deg: 30.3, east_deg: -97.7 };
    let tiles = GetTilesRequest {
        selection: Some(echofix_proto::v1::get_tiles_request::Selection::Area(area)),
        ..Default::default()
    };
    let coverage = GetCoverageRequest {
        latitude_deg: vec![30.2672; 200],
        longitude_deg: vec![-97.7431; 200],
        expectations: true,
    };
    let upload = |id| -> Vec<u8> {
        drive(id, 30.2672, -97.7431).iter().flat_map(|part| framed(0, &part.encode_to_vec())).collect()
    };
    let bodies: [(&str, &(dyn Fn() -> Vec<u8> + Sync)); 4] = [
        (LOCALIZE, &|| framed(0, &[])),
        (TILES, &|| framed(0, &tiles.encode_to_vec())),
        (COVERAGE, &|| framed(0, &coverage.encode_to_vec())),
        (UPLOAD, &|| upload(Uuid::now_v7())),
    ];
    for (path, body) in bodies {
        for round in 0..60_u64 {
            // Before the headers, in the body, while it works, while it answers.
            let body = body();
            let (first, rest) = body.split_at(body.len() * (round as usize % 4) / 3);
            let pieces = [first.to_vec(), rest.to_vec()];
            let paced = tokio_stream::iter(pieces).then(move |piece| async move {
                tokio::time::sleep(Duration::from_millis(round % 3)).await;
                piece
            });
            let asked = call(server.channel().await, (server.grpc, path), None, paced);
            let _ = tokio::time::timeout(Duration::from_micros(400 * round), asked).await;
        }
    }
    // Whatever was begun has ended, or does so soon: everybody is answered again.
    for (path, body) in bodies {
        let mut last = Code::Unknown;
        for _ in 0..200 {
            let answer =
                call(server.channel().await, (server.grpc, path), None, tokio_stream::iter([body()]));
            last = status(&answer.await.unwrap()).code();
            if last != Code::ResourceExhausted {
                break;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        let expected = if path == LOCALIZE { Code::InvalidArgument } else { Code::Ok };
        assert_eq!(last, expected, "{path}");
    }
    server.stop().await;
}

/// Catches: an overloaded service that receives what it refuses, and a refusal that waits for it.
#[tokio::test(flavor = "multi_thread")]
async fn a_question_that_finds_no_place_is_refused_before_it_is_received() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("locating.threads", "1"), ("locating.queue", "0")]).await;
    let (grpc, sent) = (server.grpc, Arc::new(AtomicUsize::new(0)));
    let mut refused = 0;
    // The first has the place for as long as it may take to arrive.
    let endless = || tokio_stream::pending::<Vec<u8>>();
    let mut first = JoinSet::new();
    let deadline = tokio::time::Instant::now() + Duration::from_mins(1);
    while refused < 8 {
        assert!(tokio::time::Instant::now() < deadline, "nobody is refused");
        let channel = server.channel().await;
        first.spawn(async move { call(channel, (grpc, LOCALIZE), None, endless()).await.map(drop) });
        let counted = Arc::clone(&sent);
        let pieces = tokio_stream::iter(0..64).map(move |_| {
            counted.fetch_add(16 << 10, Ordering::Relaxed);
            vec![0; 16 << 10]
        });
        let before = sent.load(Ordering::Relaxed);
        // Its message never ends: only who is refused is answered.
        let asked = call(server.channel().await, (grpc, LOCALIZE), None, pieces.chain(endless()));
        let Ok(answer) = tokio::time::timeout(Duration::from_millis(200), asked).await else { continue };
        let told = status(&answer.unwrap());
        assert_eq!(told.code(), Code::ResourceExhausted, "{told:?}");
        assert!(told.get_details_retry_info().is_some_and(|info| info.retry_delay.is_some()), "{told:?}");
        // Beyond the window nothing is taken, then or later.
        tokio::time::sleep(Duration::from_millis(300)).await;
        let taken = sent.load(Ordering::Relaxed) - before;
        assert!(taken <= 128 << 10, "{taken} bytes of a refused question were taken");
        refused += 1;
    }
    first.abort_all();
    server.stop().await;
}
