//! Both ports on unix sockets.

use std::fs;
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use echofix_harness::process::{Launch, ServiceProcess};
use echofix_server::identity::tokens;
use echofix_tests::binary;
use echofix_tests::command::echofix;

fn settings(folder: &Path) -> Vec<String> {
    let at = |name: &str| folder.join(name).display().to_string();
    vec![
        format!("grpc.listen=unix:{}", at("grpc")),
        format!("http.listen=unix://{}", at("http")),
        "http.socket_mode=0660".to_owned(),
        "identity.proxy_header=x-echofix-caller".to_owned(),
        format!("identity.tokens={}", at("tokens")),
    ]
}

async fn start(folder: &Path) -> Result<ServiceProcess, String> {
    let (data_dir, settings) = (folder.join("data"), settings(folder));
    let launch =
        Launch { program: binary::echofix(), folder, data_dir: &data_dir, settings, variables: Vec::new() };
    ServiceProcess::started(&launch).await.map_err(|error| format!("{error:#}"))
}

/// The status of an answer.
fn get(socket: &Path, path: &str, headers: &str) -> u16 {
    let mut stream = UnixStream::connect(socket).unwrap();
    stream.set_read_timeout(Some(Duration::from_mins(1))).unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n{headers}\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or_else(|| panic!("{answer}"))
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o777
}

/// Catches: a socket that others may connect to, a proxy there that is not believed, callers there that are asked nothing, and a
/// service that does not start again where it was killed.
#[tokio::test(flavor = "multi_thread")]
async fn both_ports_are_served_by_unix_sockets() {
    let folder = tempfile::tempdir().unwrap();
    let (grpc, http) = (folder.path().join("grpc"), folder.path().join("http"));
    let token = tokens::create(&folder.path().join("tokens"), "vehicle".parse().unwrap(), "car-7").unwrap();
    let mut service = start(folder.path()).await.unwrap();
    assert_eq!(
        (&service.grpc, mode(&grpc), mode(&http)),
        (&format!("unix:{}", grpc.display()), 0o600, 0o660)
    );
    tokio::task::block_in_place(|| {
        assert_eq!(get(&http, "/healthz", ""), 200);
        assert_eq!(get(&http, "/api/v1/map", ""), 401);
        assert_eq!(get(&http, "/api/v1/map", "x-echofix-caller: viewer/alice\r\n"), 200);
        assert_eq!(get(&http, "/api/v1/map", "x-echofix-caller: vehicle/car-7\r\n"), 403);
        assert_eq!(get(&http, "/api/v1/map", "x-echofix-caller: root/alice\r\n"), 401);
        let sync = |token: &str| {
            let dir = folder.path().join("tiles").display().to_string();
            echofix(["tiles", "sync", &dir, "--server", &service.grpc, "--token", token])
        };
        let synced = sync(&token);
        assert_eq!(synced.code, Some(0), "{synced:?}");
        assert!(sync("echofix_wrong").error().contains("not known"));
    });

    let second = start(&folder.path().join(".")).await.err().unwrap();
    assert!(second.contains("another program listens there"), "{second}");
    service.kill().unwrap();
    assert!(grpc.exists() && http.exists(), "a kill leaves them");
    let service = start(folder.path()).await.unwrap();
    tokio::task::block_in_place(|| assert_eq!(get(&http, "/healthz", ""), 200));
    service.stop().await.unwrap();
    assert!(!grpc.exists() && !http.exists(), "an end removes them");
    fs::write(&http, "somebody's").unwrap();
    let refused = start(folder.path()).await.err().unwrap();
    assert!(refused.contains("no socket"), "{refused}");
    assert_eq!(fs::read_to_string(&http).unwrap(), "somebody's");
}

/// Catches: an address that is read as another, and a call that could not be made and says something else.
#[test]
fn addresses_of_sockets_are_checked() {
    let check = |more: &[&str]| echofix(["serve", "--check-config"].iter().chain(more));
    let apart = ["--grpc-listen", "unix:/run/a", "--http-listen", "unix:/run/b"];
    assert_eq!(check(&apart).code, Some(0), "only this machine reaches them");
    let same = check(&["--grpc-listen", "unix:/run/a", "--http-listen", "unix:///run/a"]);
    assert!(same.error().contains("`http.listen`"), "{same:?}");
    let mode = check(&["--set", "grpc.socket_mode=rw"]);
    assert!(mode.error().contains("`grpc.socket_mode`"), "{mode:?}");
    assert_eq!(check(&["--grpc-listen", "unix:run/a"]).code, Some(2), "of which folder?");
    let status = echofix(["status", "--http", "unix:/run/a"]);
    assert!(status.error().contains("for a proxy"), "{status:?}");
}
