//! The program itself: what it prints, how it ends.
#![expect(clippy::unwrap_used, reason = "a test fails by it")]

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_echofix-server"));
    command.args(arguments).env_remove("ECHOFIX_CONFIG");
    command
}

fn output(arguments: &[&str]) -> Output {
    program(arguments).output().unwrap()
}

#[test]
fn the_configuration_in_force_is_printed_and_checked() {
    let printed = output(&["--print-config", "--set", "mapping.max_range_m=61"]);
    assert!(printed.status.success());
    let text = String::from_utf8(printed.stdout).unwrap();
    assert!(text.contains("max_range_m = 61.0") && text.contains("[limits]"), "{text}");
    assert!(output(&["--check-config"]).status.success());

    let wrong = output(&["--check-config", "--set", "mapping.max_rnge_m=61"]);
    assert!(!wrong.status.success());
    let message = String::from_utf8(wrong.stderr).unwrap();
    assert!(message.contains("did you mean `mapping.max_range_m`?"), "{message}");
}

/// The running program; killed when the test fails.
struct RunningProgram(Child);

impl Drop for RunningProgram {
    fn drop(&mut self) {
        let _ = self.0.kill();
    }
}

fn start(dir: &Path) -> (RunningProgram, serde_json::Value) {
    let (data, addresses) = (dir.join("data"), dir.join("addresses.json"));
    let _ = std::fs::remove_file(&addresses);
    let arguments = ["--grpc-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0"];
    let mut command = program(&arguments);
    command.arg("--data-dir").arg(data).arg("--addr-file").arg(&addresses);
    let child = RunningProgram(command.stderr(Stdio::null()).spawn().unwrap());
    let deadline = Instant::now() + Duration::from_secs(20);
    while !addresses.exists() {
        assert!(Instant::now() < deadline, "the server does not start");
        std::thread::sleep(Duration::from_millis(10));
    }
    (child, serde_json::from_slice(&std::fs::read(addresses).unwrap()).unwrap())
}

/// The body of an answer to a GET request.
fn body(address: &str, path: &str) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).unwrap();
    // This version ends an answer with its connection, so nothing is cut into chunks.
    stream.write_all(format!("GET {path} HTTP/1.0\r\n\r\n").as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let head = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap();
    answer.split_off(head + 4)
}

// Not beside the tests of the store: a process that is being started holds the locks of all files open in this one.
#[test]
fn other_tools_read_a_backup() {
    let dir = tempfile::tempdir().unwrap();
    let (_server, addresses) = start(dir.path());
    let archive = dir.path().join("backup.tar");
    std::fs::write(&archive, body(addresses["http"].as_str().unwrap(), "/api/v1/map/backup")).unwrap();
    let listed = Command::new("tar").arg("tvf").arg(&archive).output().unwrap();
    let listing = String::from_utf8(listed.stdout).unwrap();
    assert!(listed.status.success() && listing.contains("key") && listing.contains("journal/"), "{listing}");
    assert!(listing.lines().all(|line| line.starts_with("-rw-------")), "{listing}");
}

#[test]
fn sigterm_ends_it_with_success_and_a_kill_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let (mut killed, _) = start(dir.path());
    killed.0.kill().unwrap();
    killed.0.wait().unwrap();

    let (mut server, addresses) = start(dir.path());
    TcpStream::connect(addresses["grpc"].as_str().unwrap()).unwrap();
    // A connection that stays silent must not hold the end up.
    let _silent = TcpStream::connect(addresses["http"].as_str().unwrap()).unwrap();
    let began = Instant::now();
    assert!(Command::new("kill").arg(server.0.id().to_string()).status().unwrap().success());
    assert!(server.0.wait().unwrap().success());
    assert!(began.elapsed() < Duration::from_secs(12), "{:?}", began.elapsed());
}
