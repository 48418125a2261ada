//! Whom the service itself believes when it asks an issuer.

use std::io::Read;
use std::net::TcpListener;
use std::time::Duration;

use echofix_harness::process::{Launch, ServiceProcess};
use echofix_tests::{binary, until_blocking};

use super::issuer::Issuer;

/// Catches: an image without any authority's certificate, in which the service asks no issuer at all.
#[test]
fn an_issuer_is_asked_where_the_system_has_no_authorities() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let settings = Issuer::settings(&format!("https://{}/keys", listener.local_addr().unwrap()));
    let folder = tempfile::tempdir().unwrap();
    let launch = Launch {
        program: binary::echofix(),
        folder: folder.path(),
        data_dir: &folder.path().join("data"),
        settings,
        variables: vec![("SSL_CERT_FILE", "/nonexistent"), ("SSL_CERT_DIR", "/nonexistent")],
    };
    let service = ServiceProcess::launch(&launch).unwrap();
    let asked = until_blocking("the issuer is asked", Duration::from_mins(1), || listener.accept().ok());
    let (mut stream, _) = asked;
    stream.set_nonblocking(false).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    let mut first = [0];
    stream.read_exact(&mut first).unwrap();
    assert_eq!(first[0], 22, "a TLS handshake:\n{}", service.log());
}
