//! The service as a process of its own.

use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use serde_json::Value;

use crate::commands::status;
use tokio::process::{Child, Command};

/// The service drains its connections for some seconds before it ends.
const ENDED_WITHIN: Duration = Duration::from_secs(30);

/// The service as a process of its own.
pub struct Service {
    process: Child,
    /// Address of its gRPC port.
    pub grpc: String,
    /// Address of its HTTP port.
    pub http: String,
}

impl Service {
    /// Starts it on free ports, with its data and its log in a folder and some keys set.
    ///
    /// # Errors
    /// When it does not come up; its log is in the error.
    pub async fn start(folder: &Path, settings: &[String]) -> anyhow::Result<Self> {
        let addresses = folder.join("addresses.json");
        // One of an earlier service would be taken for this one's.
        let _ = std::fs::remove_file(&addresses);
        let process = Command::new(std::env::current_exe()?)
            .arg("serve")
            .args(["--grpc-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0", "--data-dir"])
            .arg(folder.join("data"))
            .arg("--addr-file")
            .arg(&addresses)
            .args(settings.iter().flat_map(|setting| ["--set", setting]))
            // Held open by this process: should it be killed, the service ends, too.
            .arg("--end-with-stdin")
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(folder.join("service.log"))?)
            .kill_on_drop(true)
            .spawn()
            .context("starting the service")?;
        let mut service = Self { process, grpc: String::new(), http: String::new() };
        service.listen(&addresses, folder).await?;
        Ok(service)
    }

    /// Waits for the addresses the service writes once it listens.
    async fn listen(&mut self, addresses: &Path, folder: &Path) -> anyhow::Result<()> {
        let deadline = Instant::now() + Duration::from_secs(30);
        loop {
            if let Ok(text) = std::fs::read_to_string(addresses)
                && let Ok(bound) = serde_json::from_str::<Value>(&text)
                && let (Some(grpc), Some(http)) = (bound["grpc"].as_str(), bound["http"].as_str())
            {
                (self.grpc, self.http) = (format!("http://{grpc}"), format!("http://{http}"));
                return Ok(());
            }
            if self.process.try_wait()?.is_some() || Instant::now() > deadline {
                let log = std::fs::read_to_string(folder.join("service.log")).unwrap_or_default();
                bail!("the service did not start:\n{log}");
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Its process id, as long as it runs.
    pub fn pid(&self) -> Option<u32> {
        self.process.id()
    }

    /// Waits until the map shows everything that was uploaded, and returns its figures.
    ///
    /// # Errors
    /// When that takes longer than two minutes.
    pub async fn settled(&self) -> anyhow::Result<Value> {
        let deadline = Instant::now() + Duration::from_mins(2);
        loop {
            let http = self.http.clone();
            let map = tokio::task::spawn_blocking(move || status::get(&http, "/api/v1/map")).await??;
            // Without an epoch, the map is not being served at all yet.
            if map["epoch"].is_u64() && map["epoch"] == map["journaled"] {
                return Ok(map);
            }
            if Instant::now() > deadline {
                bail!("the service has not folded the uploads into its map within two minutes: {map}");
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    /// Lets it finish what it has begun, so that the next one has nothing to fold again.
    ///
    /// # Errors
    /// When it does not end; it is then killed.
    pub async fn stop(mut self) -> anyhow::Result<()> {
        drop(self.process.stdin.take());
        match tokio::time::timeout(ENDED_WITHIN, self.process.wait()).await {
            Ok(ended) => ended.map(drop).context("stopping the service"),
            Err(_) => bail!("the service did not end within {} s of being told", ENDED_WITHIN.as_secs()),
        }
    }
}
