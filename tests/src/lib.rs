//! The harness of the end-to-end tests: the real binary, real sockets, a small simulated town.
//!
//! - [`binary`]: the `echofix` command, built once a test process.
//! - [`service`]: the service as a process: started, killed, started again, ended, with its log.
//! - [`command`]: one run of the command, and what it said.
//! - [`disk`]: a disk whose power can be cut.
//! - [`limits`]: what the system refuses a running service.
//! - [`http`]: what the operators' port answers.
//! - [`grpc`]: clients of the vehicles' port, and refusals taken apart.
//! - [`traffic`]: vehicles that upload without pause, and the list of what was acknowledged.
//! - [`crowd`]: a crowd in one street, and evidence that no vehicle saw.
//! - [`town`]: a town of two blocks, and drives in it.
//! - [`mapping`]: a drive goes to the map.
//! - [`tiles`]: the map as a caller gets it.
//! - [`wiretap`]: a way to the service that counts the bytes on it.
//! - [`asking`]: a drive asks where it is; errors against the truth, percentiles.
//! - [`base_map`]: maps of streets to lie below the radar map.
//! - [`world`]: a town that is mapped, and the service that holds its map.
//!
//! Nothing sleeps to let something happen: [`until`] polls with a deadline. All randomness comes
//! from [`town::seed`], which a failing test prints.

#![expect(clippy::missing_panics_doc, reason = "a harness panics: that is how a test fails")]

pub mod asking;
pub mod base_map;
pub mod binary;
pub mod command;
pub mod crowd;
pub mod disk;
pub mod grpc;
pub mod http;
pub mod limits;
pub mod mapping;
pub mod seaweedfs;
pub mod service;
pub mod tiles;
pub mod town;
pub mod traffic;
pub mod wiretap;
pub mod world;

use std::time::{Duration, Instant};

/// Asks again and again until there is an answer; fails the test after `deadline`.
pub async fn until<T>(what: &str, deadline: Duration, mut ask: impl AsyncFnMut() -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        if let Some(answer) = ask().await {
            return answer;
        }
        assert!(began.elapsed() < deadline, "waited {deadline:?} in vain until {what}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// The same for code that may block.
pub fn until_blocking<T>(what: &str, deadline: Duration, mut ask: impl FnMut() -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return answer;
        }
        assert!(began.elapsed() < deadline, "waited {deadline:?} in vain until {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}
