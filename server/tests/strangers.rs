//! What a stranger sends over a real socket: refused, told whose fault it is, and the service goes on.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod common;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use axum::http::{Request, Response, Uri};
use common::{NOON_US, TestServer, drive, header, header_of};
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{
    Batch, EvidenceChunk, GeodeticPose, LocalizeRequest, LocalizeStreamRequest, Odometry, Prior, Requirement,
    SensorMount, UploadRequest,
};
use prost::Message;
use tonic::body::Body;
use tonic::{Code, Status};
use tonic_types::StatusExt;
use tower::ServiceExt;
use uuid::Uuid;

/// Spoils a request, whose odometry comes along.
type Spoil = fn(&mut LocalizeRequest, Odometry);

const LOCALIZE: &str = "/echofix.v1.LocalizationService/Localize";
const UPLOAD: &str = "/echofix.v1.MappingService/Upload";
const COVERAGE: &str = "/echofix.v1.MapService/GetCoverage";
const TILES: &str = "/echofix.v1.MapService/GetTiles";
const HEALTH: &str = "/grpc.health.v1.Health/Check";
const CALLS: [&str; 5] = [LOCALIZE, UPLOAD, COVERAGE, TILES, HEALTH];

/// A message as gRPC frames it.
fn framed(flag: u8, message: &[u8]) -> Vec<u8> {
    [&[flag][..], &(message.len() as u32).to_be_bytes(), message].concat()
}

/// What comes back for such a body.
async fn answer(server: &TestServer, path: &str, encoding: Option<&str>, body: Vec<u8>) -> Response<Body> {
    let uri: Uri = format!("http://{}{path}", server.grpc).parse().unwrap();
    let request = Request::post(uri).header("content-type", "application/grpc").header("te", "trailers");
    let request = encoding.into_iter().fold(request, |request, name| request.header("grpc-encoding", name));
    let request = request.body(Body::new(axum::body::Body::from(body))).unwrap();
    server.channel().await.oneshot(request).await.unwrap()
}

/// The status of a call that fails before its answer; none of one that is answered.
async fn refusal(server: &TestServer, path: &str, encoding: Option<&str>, body: Vec<u8>) -> Option<Status> {
    Status::from_header_map(answer(server, path, encoding, body).await.headers())
}

/// Catches: the transport's INTERNAL for what a caller sent, to a vehicle a defect of the service.
#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_read_is_the_callers_fault_and_never_the_services() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let message = [0x0a, 0x7f, 1, 2, 3];
    for path in CALLS {
        for (encoding, body) in [
            (None, framed(0, &message)),
            (None, framed(0, &[0xff; 40])),
            (None, framed(1, &message)),
            (None, framed(7, &message)),
            (None, framed(0, &message)[..7].to_vec()),
            (None, vec![0, 0]),
            (Some("gzip"), framed(1, &message)),
            (Some("zstd"), framed(1, &message)),
        ] {
            let told = refusal(&server, path, encoding, body.clone()).await.unwrap();
            if path == HEALTH && encoding.is_some() {
                assert_eq!(told.code(), Code::Unimplemented);
                continue;
            }
            assert_eq!(told.code(), Code::InvalidArgument, "{path} {encoding:?} {body:x?}: {told:?}");
            let details = told.get_details_bad_request().unwrap();
            assert!(!details.field_violations[0].description.is_empty(), "{told:?}");
        }
    }
    assert!(metric(&server, "echofix_refused_calls_total{outcome=\"INVALID_ARGUMENT\"}") >= 38.0);
    server.stop().await;
}

/// A metric's value, as an operator reads it.
fn metric(server: &TestServer, name: &str) -> f64 {
    let text = http(server.http, "GET /metrics HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
    let line =
        text.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_else(|| panic!("{name} in {text}"));
    line.trim().parse().unwrap()
}

/// Catches: a mutated message that fails as the service's fault, wherever the change lies.
#[tokio::test(flavor = "multi_thread")]
async fn no_change_of_a_sound_message_makes_the_service_fail() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let messages = drive(Uuid::now_v7(), 30.2672, -97.7431);
    let sound: Vec<u8> = messages.iter().flat_map(|message| framed(0, &message.encode_to_vec())).collect();
    let asked = framed(0, &request(1e-3).encode_to_vec());
    for (path, sound) in [(UPLOAD, &sound), (LOCALIZE, &asked)] {
        for at in (5..sound.len().min(1_500)).step_by(3) {
            let mut changed = sound.clone();
            changed[at] ^= 0x81_u8.rotate_left(at as u32 % 8);
            if let Some(told) = refusal(&server, path, None, changed).await {
                assert_ne!(told.code(), Code::Internal, "{path} at {at}: {told:?}");
            }
        }
    }
    server.stop().await;
}

/// A question about a place that nothing is known of.
fn request(integrity_risk: f64) -> LocalizeRequest {
    let Some(Part::Chunk(chunk)) = drive(Uuid::nil(), 30.2672, -97.7431).remove(1).part else {
        panic!("a chunk")
    };
    let scans = chunk.scans.unwrap();
    let rows = scans.time_offset_us.len();
    let odometry = Odometry {
        time_offset_us: scans.time_offset_us.clone(),
        x_m: (0..rows).map(|row| row as f64).collect(),
        y_m: vec![0.0; rows],
        yaw_rad: vec![0.0; rows],
        ..Odometry::default()
    };
    let batch = Batch {
        reference_time_us: NOON_US,
        mounts: vec![SensorMount::default()],
        scans: Some(scans),
        odometry: Some(odometry),
        ..Batch::default()
    };
    let pose = Some(GeodeticPose { latitude_deg: 30.2672, longitude_deg: -97.7431, yaw_rad: 0.0 });
    let prior = Prior { pose, sigma_position_m: 1.0, sigma_yaw_rad: 0.02, ..Prior::default() };
    let requirement = Some(Requirement { integrity_risk, alert_limit_m: 0.0 });
    LocalizeRequest { batch: Some(batch), prior: Some(prior), requirement }
}

/// Catches: a risk for which valid levels are nothing, and numbers beyond any vehicle.
#[tokio::test(flavor = "multi_thread")]
async fn numbers_beyond_their_range_are_refused_with_their_field() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let mut client = LocalizationServiceClient::new(server.channel().await);
    let mut field = async |request: LocalizeRequest| {
        let told = client.localize(request).await.unwrap_err();
        told.get_details_bad_request().map(|bad| bad.field_violations[0].field.clone())
    };
    for risk in [0.999, 0.5, 0.100_001, 1e-10, 1e-300, -1e-3, f64::NAN, f64::INFINITY] {
        assert_eq!(field(request(risk)).await.as_deref(), Some("requirement.integrity_risk"), "{risk}");
    }
    for risk in [0.0, 0.1, 1e-9] {
        assert_eq!(field(request(risk)).await, None, "{risk}: refused for another reason");
    }
    let odometry = |request: &mut LocalizeRequest| request.batch.as_mut().unwrap().odometry.take().unwrap();
    let spoils: [(&str, Spoil); 7] = [
        ("requirement.alert_limit_m", |r, _| r.requirement.as_mut().unwrap().alert_limit_m = 1e9),
        ("prior.sigma_position_m", |r, _| r.prior.as_mut().unwrap().sigma_position_m = 1e-9),
        ("prior.sigma_yaw_rad", |r, _| r.prior.as_mut().unwrap().sigma_yaw_rad = 1e-12),
        ("prior.covariance", |r, _| {
            r.prior.as_mut().unwrap().covariance = vec![1.0, 0.0, 0.0, 1e-18, 0.0, 1e-4];
        }),
        ("batch.odometry.sigma", |r, o| set(r, Odometry { sigma_velocity_mps: Some(1e30), ..o })),
        ("batch.odometry.sigma", |r, o| set(r, Odometry { sigma_velocity_fraction: Some(1e9), ..o })),
        ("batch.odometry.sigma", |r, o| set(r, Odometry { sigma_yaw_rate_radps: Some(11.0), ..o })),
    ];
    for (expected, spoil) in spoils {
        let mut spoilt = request(0.0);
        let way = odometry(&mut spoilt);
        set(&mut spoilt, way.clone());
        spoil(&mut spoilt, way);
        assert_eq!(field(spoilt).await.as_deref(), Some(expected));
    }
    server.stop().await;
}

fn set(request: &mut LocalizeRequest, odometry: Odometry) {
    request.batch.as_mut().unwrap().odometry = Some(odometry);
}

/// Catches: a stream that computes on for a vehicle that waits no more.
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_ends_with_its_deadline() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let mut client = LocalizationServiceClient::new(server.channel().await);
    let (sender, receiver) = tokio::sync::mpsc::channel(4);
    let mut asked = tonic::Request::new(tokio_stream::wrappers::ReceiverStream::new(receiver));
    asked.set_timeout(Duration::from_millis(300));
    let mut answers = client.localize_stream(asked).await.unwrap().into_inner();
    let question =
        |sequence| LocalizeStreamRequest { sequence, request: Some(request(0.0)), ..Default::default() };
    sender.send(question(1)).await.unwrap();
    assert_eq!(answers.message().await.unwrap().unwrap().sequence, 1);
    tokio::time::sleep(Duration::from_millis(350)).await;
    sender.send(question(2)).await.unwrap();
    assert_eq!(answers.message().await.unwrap_err().code(), Code::DeadlineExceeded);
    server.stop().await;
}

/// Catches: one upload of a wrong clock, by whose day the whole map would be old.
#[tokio::test(flavor = "multi_thread")]
async fn uploads_of_the_day_after_tomorrow_are_refused_of_either_kind() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_micros() as i64;
    let hour = 3_600_000_000;
    let evidence = EvidenceChunk { contribution: b"EFC".to_vec(), ..EvidenceChunk::default() };
    let evidence = vec![header(Uuid::now_v7()), UploadRequest { part: Some(Part::Evidence(evidence)) }];
    for mut messages in [drive(Uuid::now_v7(), 30.2672, -97.7431), evidence] {
        for ahead in [25, 49, 24 * 300] {
            header_of(&mut messages).reference_time_us = now + ahead * hour;
            let told = server.upload(messages.clone()).await.unwrap_err();
            let violation = told.get_details_bad_request().unwrap().field_violations.remove(0);
            assert_eq!(violation.field, "header.reference_time_us", "{ahead} h");
            assert!(violation.description.contains("clock"), "{violation:?}");
        }
    }
    let mut near = drive(Uuid::now_v7(), 30.2672, -97.7431);
    header_of(&mut near).reference_time_us = now + 23 * hour;
    server.upload(near).await.unwrap();
    server.stop().await;
}

/// Catches: a question of megabytes that comes back in the trailers.
#[tokio::test(flavor = "multi_thread")]
async fn questions_about_the_service_are_as_short_as_names_are() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let info = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";
    for path in [info, HEALTH] {
        for size in [600, 1 << 20, (4 << 20) - 100] {
            // The first field of either is a name.
            let mut message = vec![if path == info { 0x22 } else { 0x0a }];
            prost::encoding::encode_varint(size as u64, &mut message);
            message.resize(message.len() + size, b'x');
            let response = answer(&server, path, None, framed(0, &message)).await;
            let headers: usize =
                response.headers().iter().map(|(name, value)| name.as_str().len() + value.len()).sum();
            assert!(headers < 2_000, "{path}: {headers} bytes of headers");
            let body = axum::body::to_bytes(axum::body::Body::new(response.into_body()), 2_000).await;
            assert!(body.unwrap().len() < 2_000, "{path}");
        }
    }
    server.stop().await;
}

/// All that an HTTP server answers.
fn http(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut text = String::new();
    // A server that closes with unread bytes resets the connection.
    let _ = stream.read_to_string(&mut text);
    text
}

/// Catches: a page whose name was led here, or one that sends a form here, which does what only operators may.
#[tokio::test(flavor = "multi_thread")]
async fn other_names_and_other_pages_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("http.hosts", "[\"maps.example.com\"]")]).await;
    let own = format!("127.0.0.1:{}", server.http.port());
    let status = |method: &str, path: &str, host: &str, more: &str| {
        let request = format!(
            "{method} {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\ncontent-length: 0\r\n{more}\r\n"
        );
        http(server.http, &request)[9..12].to_owned()
    };
    for path in ["/api/v1/map/backup", "/", "/metrics", "/nowhere"] {
        assert_eq!(status("GET", path, "evil.example", ""), "421", "{path}");
    }
    for host in [&own, "localhost", "maps.example.com"] {
        assert_eq!(status("GET", "/api/v1/map", host, ""), "200", "{host}");
    }
    let compact = "/api/v1/map/compact";
    assert_eq!(status("POST", compact, "evil.example", ""), "421");
    assert_eq!(status("POST", compact, &own, "origin: http://evil.example\r\n"), "403");
    assert_eq!(status("POST", compact, &own, "origin: null\r\n"), "403");
    assert_eq!(
        status("POST", compact, &own, &format!("origin: http://{own}\r\n")),
        "400",
        "it lacks a body only"
    );
    assert_eq!(status("GET", "/api/v1/map/verify?replay=true", &own, ""), "405");
    assert_eq!(status("POST", "/api/v1/map/verify?replay=true", &own, ""), "200");
    server.stop().await;
}

/// Frames that carry no request, on stream 0, on stream 1, which is over, or on stream 3, whose body is coming: type, flags, bytes of the
/// payload.
const EMPTY_FRAMES: [(u8, u8, u8, usize); 9] = [
    (6, 0, 0, 8),
    (4, 0, 0, 0),
    (2, 0, 1, 5),
    (8, 0, 0, 4),
    (0xbb, 0, 0, 4),
    (3, 0, 1, 4),
    (0, 0, 3, 0),
    (0, 0, 3, 1),
    (0, 8, 3, 200),
];

/// Catches: pings, settings and the like, taken by the million after one sound request, on either port.
#[tokio::test(flavor = "multi_thread")]
async fn floods_of_frames_close_the_connection_soon() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    for address in [server.grpc, server.http] {
        for frame in EMPTY_FRAMES {
            let closed = tokio::task::spawn_blocking(move || flooded(address, frame)).await.unwrap();
            let soon = closed.is_some_and(|after| after < Duration::from_secs(2));
            assert!(soon, "port {}, frames {frame:?}: {closed:?}", address.port());
        }
    }
    server.upload(drive(Uuid::now_v7(), 30.2672, -97.7431)).await.expect("others are served");
    server.stop().await;
}

/// A frame of HTTP/2.
fn http2_frame(kind: u8, flags: u8, stream: u8, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_be_bytes();
    [&length[1..], &[kind, flags, 0, 0, 0, stream], payload].concat()
}

/// The headers of a request; a path that is not in the table of HPACK is spelt.
fn headers(method: u8, path: &str) -> Vec<u8> {
    let text = |index: u8, text: &str| [&[0x40 | index, text.len() as u8][..], text.as_bytes()].concat();
    [vec![method, 0x86], text(4, path), text(1, "localhost"), text(31, "application/grpc")].concat()
}

/// After how long a connection that sends such frames is closed; none within five seconds.
fn flooded(address: SocketAddr, (kind, flags, stream_id, payload): (u8, u8, u8, usize)) -> Option<Duration> {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_write_timeout(Some(Duration::from_secs(1))).unwrap();
    let mut drain = stream.try_clone().unwrap();
    std::thread::spawn(move || while drain.read(&mut [0; 8_192]).is_ok_and(|read| read > 0) {});
    let sound = [
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec(),
        http2_frame(4, 0, 0, &[]),
        http2_frame(1, 5, 1, &headers(0x82, "/")),
        http2_frame(1, 4, 3, &headers(0x83, if stream_id == 3 { UPLOAD } else { "/" })),
    ];
    stream.write_all(&sound.concat()).unwrap();
    // The last byte is 1, for a window that grows by no more; of what is padded the first says how much is padding.
    let mut bytes: Vec<u8> = (0..payload).map(|at| u8::from(at + 1 == payload)).collect();
    if flags == 8 {
        bytes = [vec![(payload - 1) as u8], vec![0; payload - 1]].concat();
    }
    let frames = http2_frame(kind, flags, stream_id, &bytes).repeat(500);
    // The first request is over by then.
    std::thread::sleep(Duration::from_millis(50));
    let began = Instant::now();
    while began.elapsed() < Duration::from_secs(5) {
        if stream.write_all(&frames).is_err() {
            return Some(began.elapsed());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    None
}
