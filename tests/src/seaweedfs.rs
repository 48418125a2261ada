//! An S3-compatible store as a process: `SeaweedFS`, see `tests/s3/seaweedfs`.

use std::fs::File;
use std::net::TcpListener;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};
use std::time::Duration;

use tempfile::TempDir;

use crate::until_blocking;

/// From its start until it takes objects.
const READY_WITHIN: Duration = Duration::from_mins(1);

/// A store with one bucket, `maps`; killed when it is dropped.
pub struct SeaweedFs {
    folder: TempDir,
    port: u16,
    process: Child,
}

impl SeaweedFs {
    /// Starts a store on free ports and waits until its bucket is there.
    ///
    /// # Panics
    /// When the program is not there and cannot be fetched.
    pub fn start() -> Self {
        let installed = Command::new(script()).arg("install").output().expect("bash can be run");
        assert!(installed.status.success(), "{}", String::from_utf8_lossy(&installed.stderr));
        let folder = tempfile::tempdir().expect("a folder can be made");
        let port = free_ports();
        let process = launch(&folder, port);
        let store = Self { folder, port, process };
        store.wait();
        store
    }

    /// Ends the process as a crash would: kill -9.
    pub fn kill(&mut self) {
        // It may have ended by itself.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }

    /// Starts a killed store again on the same data, at the same address.
    pub fn start_again(&mut self) {
        self.process = launch(&self.folder, self.port);
        self.wait();
    }

    /// What a service needs in its environment to use it.
    pub fn variables(&self) -> Vec<(&'static str, String)> {
        vec![
            ("AWS_ACCESS_KEY_ID", "test".to_owned()),
            ("AWS_SECRET_ACCESS_KEY", "test-secret".to_owned()),
            ("AWS_REGION", "us-east-1".to_owned()),
            ("AWS_ENDPOINT_URL", format!("http://127.0.0.1:{}", self.port)),
        ]
    }

    /// Making the bucket, through the port for files, says whether all of it works.
    fn wait(&self) {
        let bucket = format!("http://127.0.0.1:{}/buckets/maps/", self.port + 3);
        let s3 = format!("127.0.0.1:{}", self.port);
        until_blocking("the object store is ready", READY_WITHIN, || {
            // It is there already where only the other port was late, or the store was started again.
            let made = matches!(ureq::post(&bucket).send_empty(), Ok(_) | Err(ureq::Error::StatusCode(409)));
            (made && std::net::TcpStream::connect(&s3).is_ok()).then_some(())
        });
    }
}

impl Drop for SeaweedFs {
    fn drop(&mut self) {
        self.kill();
        if std::thread::panicking() {
            let log = std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default();
            let from = log.char_indices().rev().nth(3000).map_or(0, |(at, _)| at);
            eprintln!("--- the end of the object store's log ---\n{}", &log[from..]);
        }
    }
}

fn script() -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "s3", "seaweedfs"].iter().collect()
}

fn launch(folder: &TempDir, port: u16) -> Child {
    let log = File::options().create(true).append(true).open(folder.path().join("log"));
    let log = log.expect("a log can be written");
    let mut run = Command::new(script());
    run.arg("run").arg(folder.path().join("data")).arg(port.to_string());
    run.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log).spawn().expect("bash can be run")
}

/// The first of five ports that are free, as those 10000 above them are. Another test of this process gets others, though none
/// is taken yet.
fn free_ports() -> u16 {
    static STARTED: AtomicU16 = AtomicU16::new(0);
    let free = |port: u16| TcpListener::bind(("127.0.0.1", port)).is_ok();
    let started = STARTED.fetch_add(1, Ordering::Relaxed);
    let begin = 20_000 + (std::process::id() % 400) as u16 * 10 + started * 1000;
    let mut candidates = (begin..29_000).chain(20_000..begin).step_by(10);
    let found = candidates.find(|port| (*port..port + 5).all(|port| free(port) && free(port + 10_000)));
    found.expect("some ports are free")
}
