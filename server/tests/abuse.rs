//! What a peer cannot do by being slow, many, or refused: over real sockets.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod common;

use std::io::{Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

use common::{TestServer, drive, header};
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use prost::Message;
use tokio::net::TcpSocket;
use tokio::task::JoinSet;
use tokio_stream::StreamExt;
use tonic::Code;
use tonic::transport::{Channel, Endpoint};
use tower::service_fn;
use uuid::Uuid;

/// Loopback has many addresses: peers of their own.
const STRANGER: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(127, 0, 0, 2));
const HONEST: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(127, 0, 0, 3));

/// A connection to a port from an address.
async fn from(address: IpAddr, to: SocketAddr) -> tokio::net::TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind((address, 0).into()).unwrap();
    socket.connect(to).await.unwrap()
}

/// A gRPC channel from an address.
async fn channel_from(address: IpAddr, to: SocketAddr) -> Channel {
    let connector = service_fn(move |_| async move {
        Ok::<_, std::io::Error>(hyper_util::rt::TokioIo::new(from(address, to).await))
    });
    Endpoint::from_shared(format!("http://{to}")).unwrap().connect_with_connector(connector).await.unwrap()
}

/// Uploads that begin and never end, from an address.
async fn dribble(address: IpAddr, to: SocketAddr, uploads: usize) -> JoinSet<Code> {
    let mut calls = JoinSet::new();
    for _ in 0..uploads {
        let mut client = MappingServiceClient::new(channel_from(address, to).await);
        let begun = tokio_stream::iter([header(Uuid::now_v7())]).chain(tokio_stream::pending());
        calls.spawn(
            async move { client.upload(begun).await.map_or_else(|status| status.code(), |_| Code::Ok) },
        );
    }
    calls
}

/// Catches: sixteen uploads that dribble, and nobody else may upload.
#[tokio::test(flavor = "multi_thread")]
async fn slow_uploads_keep_nobody_else_out() {
    let dir = tempfile::tempdir().unwrap();
    let server =
        TestServer::with(dir.path(), &[("mapping.uploads_at_once", "4"), ("limits.stall_s", "3")]).await;
    let mut slow = dribble(STRANGER, server.grpc, 20).await;
    // Those that have no place are told at once; the others are being received.
    let mut refused = 0;
    while refused < 16 {
        assert_eq!(slow.join_next().await.unwrap().unwrap(), Code::ResourceExhausted);
        refused += 1;
    }
    let mut honest = MappingServiceClient::new(channel_from(HONEST, server.grpc).await);
    for _ in 0..8 {
        honest
            .upload(tokio_stream::iter(drive(Uuid::now_v7(), 30.2672, -97.7431)))
            .await
            .expect("it has places");
    }
    while let Some(ended) = slow.join_next().await {
        assert_eq!(ended.unwrap(), Code::DeadlineExceeded, "who sends nothing is given up");
    }
    server.stop().await;
}

/// Catches: an honest vehicle on a slow network whose upload never gets through, because a gap decides.
#[tokio::test(flavor = "multi_thread")]
async fn a_slow_network_passes() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("limits.stall_s", "1")]).await;
    // One message takes several times the longest silence.
    let sent: Vec<u8> = drive(Uuid::now_v7(), 30.2672, -97.7431)
        .iter()
        .flat_map(|message| {
            let message = message.encode_to_vec();
            [&[0][..], &(message.len() as u32).to_be_bytes(), &message].concat()
        })
        .collect();
    let pieces: Vec<_> = sent.chunks(sent.len().div_ceil(12)).map(<[u8]>::to_vec).collect();
    let body = tokio_stream::iter(pieces).then(|piece| async move {
        tokio::time::sleep(Duration::from_millis(250)).await;
        Ok::<_, std::io::Error>(piece)
    });
    let request =
        axum::http::Request::post(format!("http://{}/echofix.v1.MappingService/Upload", server.grpc))
            .header("content-type", "application/grpc")
            .header("te", "trailers")
            .body(tonic::body::Body::new(axum::body::Body::from_stream(body)))
            .unwrap();
    let answer = tower::ServiceExt::oneshot(server.channel().await, request).await.unwrap();
    let whole = axum::body::to_bytes(axum::body::Body::new(answer.into_body()), 1 << 20).await.unwrap();
    assert!(whole.len() > 5, "an answer");
    server.stop().await;
}

/// The status line of a request, whose body may be half sent.
fn status_of(stream: &mut TcpStream) -> String {
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).unwrap();
    String::from_utf8_lossy(&answer[9..]).into_owned()
}

/// A request that says it has a body, and sends none of it.
fn bodiless(to: SocketAddr, path: &str) -> TcpStream {
    let mut stream = TcpStream::connect(to).unwrap();
    let head = format!(
        "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/octet-stream\r\ncontent-length: 4096\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream
}

/// Catches: two imports whose bodies never come, and operators are out for an hour.
#[tokio::test(flavor = "multi_thread")]
async fn bodies_that_never_come_keep_no_operator_out() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("limits.stall_s", "2")]).await;
    let http = server.http;
    let told = tokio::task::spawn_blocking(move || {
        let mut held: Vec<_> = (0..40).map(|_| bodiless(http, "/api/v1/map/import")).collect();
        let mut decision = TcpStream::connect(http).unwrap();
        let body = br#"{"before": "2020-01-01"}"#;
        let head = format!(
            "POST /api/v1/map/compact HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: {}\r\n\r\n",
            body.len()
        );
        decision.write_all(&[head.as_bytes(), body].concat()).unwrap();
        let decided = status_of(&mut decision);
        (decided, held.iter_mut().map(status_of).collect::<Vec<_>>())
    });
    let (decided, held) = told.await.unwrap();
    assert_eq!(decided, "200");
    let (slow, full) =
        (held.iter().filter(|s| *s == "408").count(), held.iter().filter(|s| *s == "503").count());
    assert!(slow >= 1 && slow + full == 40, "{held:?}");
    server.stop().await;
}

/// Catches: connections that once asked, answer pings and are held for ever, so that nobody else may connect.
#[tokio::test(flavor = "multi_thread")]
async fn idle_connections_make_room_and_age_out() {
    let dir = tempfile::tempdir().unwrap();
    let settings = [("limits.connections", "12"), ("limits.idle_s", "4")];
    let server = TestServer::with(dir.path(), &settings).await;
    let mut idle = Vec::new();
    // Of one address only its share is let in at once; of several, all.
    for number in 10..16 {
        let address = IpAddr::from([127, 0, 0, number]);
        for _ in 0..2 {
            let channel = channel_from(address, server.grpc).await;
            ask(&channel).await.unwrap();
            idle.push(channel);
        }
    }
    // All places are taken by those who have nothing to ask: soon one of them is idle.
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        let one = tokio::time::timeout(Duration::from_secs(1), channel_from(HONEST, server.grpc)).await;
        if let Ok(channel) = one
            && ask(&channel).await.is_ok()
        {
            break;
        }
        assert!(Instant::now() < deadline, "nobody makes room");
    }
    server.stop().await;

    let other = tempfile::tempdir().unwrap();
    let server = TestServer::with(other.path(), &[("limits.idle_s", "1")]).await;
    let mut stream = TcpStream::connect(server.http).unwrap();
    stream.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("it is closed, not cut off");
    assert!(answer.starts_with(b"HTTP/1.1 200"));
    server.stop().await;
}

/// Asks whether the service is there.
async fn ask(channel: &Channel) -> Result<(), tonic::Status> {
    let mut client = tonic_health::pb::health_client::HealthClient::new(channel.clone());
    let asked = client.check(tonic_health::pb::HealthCheckRequest::default());
    let answer = tokio::time::timeout(Duration::from_secs(5), asked).await;
    answer.unwrap_or_else(|_| Err(tonic::Status::deadline_exceeded("no answer"))).map(drop)
}

/// Catches: one address that holds all connections, whatever it does with them.
#[tokio::test(flavor = "multi_thread")]
async fn one_address_has_its_share_of_connections() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("limits.connections", "8")]).await;
    let mut held = Vec::new();
    for _ in 0..40 {
        held.push(from(STRANGER, server.grpc).await);
    }
    let channel = channel_from(HONEST, server.grpc).await;
    ask(&channel).await.expect("there is room for another address");
    server.stop().await;
}

/// Catches: readers with closed windows that hold what others need to read.
#[tokio::test(flavor = "multi_thread")]
async fn readers_that_take_nothing_keep_nobody_out() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("limits.reads_at_once", "2")]).await;
    server.upload(drive(Uuid::now_v7(), 30.2672, -97.7431)).await.unwrap();
    let area =
        echofix_proto::v1::GeodeticBox { south_deg: 30.2, west_deg: -97.8, north_deg: 30.3, east_deg: -97.7 };
    let request = echofix_proto::v1::GetTilesRequest {
        selection: Some(echofix_proto::v1::get_tiles_request::Selection::Area(area)),
        ..Default::default()
    };
    let mut held = Vec::new();
    for _ in 0..16 {
        let channel = channel_from(STRANGER, server.grpc).await;
        let mut client = echofix_proto::v1::map_service_client::MapServiceClient::new(channel);
        // Begun, and never read.
        held.push(client.get_tiles(request.clone()).await);
    }
    assert!(held.iter().filter(|call| call.is_ok()).count() >= 4);
    let channel = channel_from(HONEST, server.grpc).await;
    let mut client = echofix_proto::v1::map_service_client::MapServiceClient::new(channel);
    let mut answers = client.get_tiles(request).await.expect("it may read").into_inner();
    while answers.message().await.unwrap().is_some() {}
    server.stop().await;
}

/// Catches: a proxy's connection that ends, with everybody's calls on it, because the service refused many of them early.
#[tokio::test(flavor = "multi_thread")]
async fn refusals_are_not_held_against_the_connection() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let channel = server.channel().await;
    let refused = Arc::new(tokio::sync::Semaphore::new(48));
    let mut calls = JoinSet::new();
    for _ in 0..3_000 {
        let (permit, channel) = (refused.clone().acquire_owned().await.unwrap(), channel.clone());
        let uri = format!("http://{}/echofix.v1.NoService/Nothing", server.grpc);
        calls.spawn(async move {
            let body = axum::body::Body::from(vec![0; 160_000]);
            let request = axum::http::Request::post(uri).header("content-type", "application/grpc");
            let request = request.header("te", "trailers").body(tonic::body::Body::new(body)).unwrap();
            let answer = tower::ServiceExt::oneshot(channel, request).await;
            drop(permit);
            answer.map(|answer| answer.headers()["grpc-status"].clone())
        });
    }
    while let Some(call) = calls.join_next().await {
        assert_eq!(call.unwrap().expect("the connection stays"), "12");
    }
    ask(&channel).await.expect("others on it are served");
    server.stop().await;
}
