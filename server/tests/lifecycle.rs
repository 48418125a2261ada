//! Starting, being ready, ending, and what a connection may cost.

#![expect(clippy::unwrap_used, reason = "a test fails by it")]

mod common;

use std::time::{Duration, Instant};

use common::{TestServer, config, drive};
use echofix_server::run::{Error, Server, serve};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use uuid::Uuid;

#[tokio::test]
async fn health_serves_when_ready_and_a_watcher_sees_the_end() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("limits.shutdown_s", "1")]).await;
    let mut client = HealthClient::new(server.channel().await);
    let request = HealthCheckRequest { service: "echofix.v1.MapService".to_owned() };
    let mut watch = client.watch(request).await.unwrap().into_inner();
    let deadline = Instant::now() + Duration::from_secs(10);
    while watch.message().await.unwrap().unwrap().status() != ServingStatus::Serving {
        assert!(Instant::now() < deadline);
    }
    let stopping = tokio::spawn(server.stop());
    assert_eq!(watch.message().await.unwrap().unwrap().status(), ServingStatus::NotServing);
    let began = Instant::now();
    stopping.await.unwrap();
    assert!(began.elapsed() < Duration::from_secs(3), "an endless stream does not hold the service up");
}

#[tokio::test]
async fn silent_and_dribbling_connections_are_closed_on_both_ports() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("limits.handshake_s", "1")]).await;
    for address in [server.grpc, server.http] {
        for first in [&b""[..], b"P", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"GET / HTTP/1.1\r\nHost: x\r\n"] {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(first).await.unwrap();
            let mut rest = Vec::new();
            let closed = tokio::time::timeout(Duration::from_secs(5), stream.read_to_end(&mut rest)).await;
            assert!(closed.is_ok(), "{address} waits for more than {first:?}");
        }
    }
    assert!(server.upload(drive(Uuid::nil(), 30.0, -97.0)).await.is_ok());
    server.stop().await;
}

#[tokio::test]
async fn connections_beyond_the_cap_are_closed_and_the_others_served() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("limits.connections", "2")]).await;
    let _held =
        [TcpStream::connect(server.grpc).await.unwrap(), TcpStream::connect(server.grpc).await.unwrap()];
    let mut third = TcpStream::connect(server.grpc).await.unwrap();
    let closed = tokio::time::timeout(Duration::from_secs(5), third.read(&mut [0; 9])).await.unwrap();
    assert_eq!(closed.unwrap_or(0), 0);
    let http = http_get(server.http, "/").await;
    assert!(http.starts_with("HTTP/1.1"), "{http}");
}

/// The first bytes of an HTTP answer.
async fn http_get(address: std::net::SocketAddr, path: &str) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = vec![0; 64];
    let length = stream.read(&mut answer).await.unwrap();
    String::from_utf8_lossy(&answer[..length]).into_owned()
}

#[tokio::test]
async fn a_taken_port_and_a_taken_directory_are_reported() {
    let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let first = Server::bind(config(dir.path(), &[])).await.unwrap();
    let taken = first.addresses().grpc.to_string();
    let error = Server::bind(config(other.path(), &[("grpc.listen", &taken)])).await.err().unwrap();
    assert!(matches!(error, Error::Listen { port: "gRPC", .. }), "{error}");
    let error = Server::bind(config(dir.path(), &[])).await.err().unwrap();
    assert!(error.to_string().contains("in use by another server"), "{error}");
}

#[tokio::test]
async fn the_address_file_names_both_ports() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("addresses.json");
    let written = async {
        while !file.exists() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    serve(config(dir.path(), &[]), "0123abc", Some(&file), written).await.unwrap();
    let addresses: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    for port in ["grpc", "http"] {
        assert!(addresses[port].as_str().unwrap().starts_with("127.0.0.1:"), "{addresses}");
    }
}
