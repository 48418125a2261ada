//! The service as a process of its own.

use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use serde_json::Value;
use tokio::process::{Child, Command};

/// The service as a process of its own.
pub(super) struct Service {
    process: Child,
    /// Address of its gRPC port.
    pub(super) grpc: String,
    /// Address of its HTTP port.
    pub(super) http: String,
}

impl Service {
    pub(super) async fn start(folder: &Path) -> anyhow::Result<Self> {
        let addresses = folder.join("addresses.json");
        let process = Command::new(std::env::current_exe()?)
            .arg("serve")
            .args(["--grpc-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0", "--data-dir"])
            .arg(folder.join("data"))
            .arg("--addr-file")
            .arg(&addresses)
            .stdin(Stdio::null())
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

    pub(super) async fn stop(mut self) -> anyhow::Result<()> {
        self.process.kill().await.context("stopping the service")
    }
}
