//! From typing `echofix demo` to its first answer.

use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use echofix_harness::http::get_json;
use serde::Serialize;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::Command;

/// Between two looks whether there is an answer.
const EVERY: Duration = Duration::from_millis(50);

/// Seconds since the command was started.
#[derive(Debug, Clone, Copy, Serialize)]
#[expect(clippy::struct_field_names, reason = "all are seconds")]
pub(super) struct Demo {
    /// Until the console's address was printed.
    pub(super) console_s: f64,
    /// Until the first fix was answered.
    pub(super) first_answer_s: f64,
    /// Until the command had ended.
    pub(super) all_s: f64,
}

/// Runs a demo to its end, and watches it as the console does.
///
/// # Errors
/// When it cannot be started, says no address, or fails.
pub(super) async fn measure(program: &Path, seed: u64) -> anyhow::Result<Demo> {
    let began = Instant::now();
    let mut demo = Command::new(program)
        .args(["demo", "--exit", "--seed", &seed.to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .kill_on_drop(true)
        .spawn()
        .context("starting the demo")?;
    let stdout = demo.stdout.take().context("the demo has no output")?;
    let mut lines = BufReader::new(stdout).lines();
    let console = loop {
        let line = lines.next_line().await?.context("the demo ended before it named its console")?;
        if let Some(console) = line.strip_prefix("The console: ") {
            break console.trim().to_owned();
        }
    };
    let console_s = began.elapsed().as_secs_f64();
    while !answered(&console).await? {
        ensure!(demo.try_wait()?.is_none(), "the demo ended without an answer");
        tokio::time::sleep(EVERY).await;
    }
    let first_answer_s = began.elapsed().as_secs_f64();
    while lines.next_line().await?.is_some() {}
    ensure!(demo.wait().await?.success(), "the demo failed");
    Ok(Demo { console_s, first_answer_s, all_s: began.elapsed().as_secs_f64() })
}

/// Has the service given an answer?
async fn answered(console: &str) -> anyhow::Result<bool> {
    let console = console.to_owned();
    let fixes = tokio::task::spawn_blocking(move || get_json(&console, "/api/v1/fixes?limit=1")).await??;
    Ok(fixes["fixes"].as_array().is_some_and(|fixes| !fixes.is_empty()))
}
