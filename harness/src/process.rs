//! The service as a process of its own.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use serde_json::Value;

use crate::http::get_json;

/// From the start of the process until it listens.
const LISTENS_WITHIN: Duration = Duration::from_secs(30);
/// The service drains its connections for some seconds before it ends.
const ENDS_WITHIN: Duration = Duration::from_secs(30);
/// An upload may take this long to fold, on a busy machine.
const FOLDS_WITHIN: Duration = Duration::from_mins(2);

/// How a service is started.
#[derive(Debug, Clone)]
pub struct Launch<'a> {
    /// The `echofix` command.
    pub program: &'a Path,
    /// Holds the service's log and the addresses it listens at.
    pub folder: &'a Path,
    /// The map's folder.
    pub data_dir: &'a Path,
    /// Keys to set, each as `section.key=value`.
    pub settings: Vec<String>,
    /// Environment variables to set.
    pub variables: Vec<(&'a str, &'a str)>,
}

/// A service that ends with the process that started it, however that ends.
pub struct ServiceProcess {
    child: Child,
    folder: PathBuf,
    /// `http://host:port` for vehicles; empty until it is known.
    pub grpc: String,
    /// `http://host:port` for operators; empty until it is known.
    pub http: String,
}

impl ServiceProcess {
    /// Starts a service on free ports, unless its settings say otherwise, without waiting until it listens. Its log is added to that of earlier ones in
    /// the same folder.
    ///
    /// # Errors
    /// When the folder cannot be written or the program not be run.
    pub fn launch(launch: &Launch) -> io::Result<Self> {
        let log = File::options().create(true).append(true).open(log_file(launch.folder))?;
        // Those of an earlier service would be taken for this one's.
        let _ = fs::remove_file(address_file(launch.folder));
        let child = Command::new(launch.program)
            // Of settings the last one counts.
            .args([
                "serve",
                "--set",
                "grpc.listen=127.0.0.1:0",
                "--set",
                "http.listen=127.0.0.1:0",
                "--data-dir",
            ])
            .arg(launch.data_dir)
            .arg("--addr-file")
            .arg(address_file(launch.folder))
            .args(launch.settings.iter().flat_map(|setting| ["--set", setting]))
            .envs(launch.variables.iter().copied())
            // Held open by this process: should it be killed, the service ends, too.
            .arg("--end-with-stdin")
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()?;
        Ok(Self { child, folder: launch.folder.to_owned(), grpc: String::new(), http: String::new() })
    }

    /// Starts this program's own service with its data in a folder, and waits until it listens.
    ///
    /// # Errors
    /// When it does not come up; its log is in the error.
    pub async fn start(folder: &Path, settings: &[String]) -> anyhow::Result<Self> {
        let launch = Launch {
            program: &std::env::current_exe()?,
            folder,
            data_dir: &folder.join("data"),
            settings: settings.to_vec(),
            variables: Vec::new(),
        };
        Self::started(&launch).await
    }

    /// Starts a service and waits until it listens.
    ///
    /// # Errors
    /// When it does not come up; its log is in the error.
    pub async fn started(launch: &Launch<'_>) -> anyhow::Result<Self> {
        let mut service = Self::launch(launch).context("starting the service")?;
        let deadline = Instant::now() + LISTENS_WITHIN;
        while !service.listens() {
            if service.ended()?.is_some() || Instant::now() > deadline {
                bail!("the service did not start:\n{}", service.log());
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        Ok(service)
    }

    /// Whether it has written the addresses it listens at; they are known from then on.
    pub fn listens(&mut self) -> bool {
        let bound = fs::read_to_string(address_file(&self.folder)).unwrap_or_default();
        let bound: Value = serde_json::from_str(&bound).unwrap_or_default();
        let (Some(grpc), Some(http)) = (bound["grpc"].as_str(), bound["http"].as_str()) else { return false };
        let url = |address: &str| {
            if address.starts_with("unix:") { address.to_owned() } else { format!("http://{address}") }
        };
        (self.grpc, self.http) = (url(grpc), url(http));
        true
    }

    /// How the process ended; `None` while it runs.
    ///
    /// # Errors
    /// When the system does not say.
    pub fn ended(&mut self) -> io::Result<Option<ExitStatus>> {
        self.child.try_wait()
    }

    /// The number of the process.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The standard-error log of this service and of earlier ones in its folder.
    #[must_use]
    pub fn log(&self) -> String {
        fs::read_to_string(log_file(&self.folder)).unwrap_or_default()
    }

    /// Ends the process as a crash would: kill -9. Nothing happens when it has ended already.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn kill(&mut self) -> io::Result<()> {
        self.child.kill()?;
        self.child.wait().map(drop)
    }

    /// Waits until the map shows everything that was uploaded, and returns its figures.
    ///
    /// # Errors
    /// When nothing was folded for two minutes.
    pub async fn folded(&self) -> anyhow::Result<Value> {
        let (mut epoch, mut since) = (Value::Null, Instant::now());
        loop {
            let http = self.http.clone();
            let map = tokio::task::spawn_blocking(move || get_json(&http, "/api/v1/map")).await??;
            if map["state"] == "serving" && map["epoch"] == map["journaled"] {
                return Ok(map);
            }
            if map["epoch"] != epoch {
                (epoch, since) = (map["epoch"].clone(), Instant::now());
            }
            if since.elapsed() > FOLDS_WITHIN {
                bail!("the service has folded nothing for two minutes: {map}");
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Lets it finish what it has begun, so that the next one has nothing to fold again.
    ///
    /// # Errors
    /// When it does not end; it is then killed.
    pub async fn stop(mut self) -> anyhow::Result<()> {
        drop(self.child.stdin.take());
        let deadline = Instant::now() + ENDS_WITHIN;
        while self.ended().context("stopping the service")?.is_none() {
            if Instant::now() > deadline {
                bail!("the service did not end within {} s of the request", ENDS_WITHIN.as_secs());
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        Ok(())
    }
}

impl Drop for ServiceProcess {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.kill();
    }
}

fn address_file(folder: &Path) -> PathBuf {
    folder.join("addresses.json")
}

fn log_file(folder: &Path) -> PathBuf {
    folder.join("service.log")
}
