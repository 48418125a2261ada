//! `echofix map history`, `diff`, `rollback`, ...: what operators see and decide, over the HTTP port.

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use echofix_harness::credentials::Credentials;
use echofix_harness::ranges::within;
use echofix_server::store::SharedMap;
use serde_json::{Value, json};
use ureq::http::Response;
use ureq::{Body, SendBody};

use super::decisions::{HowDecided, decide};
use super::map_shown as shown;
use crate::unfinished::Unfinished;

/// Longest time of an operation: some fold the whole journal again.
const WITHIN: Duration = Duration::from_hours(1);

/// An operation on the map.
#[derive(clap::Subcommand)]
pub enum MapOperation {
    /// Show the map's history: uploads, imports and operators' decisions, newest first, with their epochs.
    History {
        /// Largest number of events to show.
        #[arg(long, default_value_t = 20, value_parser = within(1..=1_000_000_u32))]
        limit: u32,
    },
    /// Show the uploads that vetting kept out of the map, newest first, and the alarms: where several contributors disagree with
    /// the map alike.
    Quarantine,
    /// Show the alarms alone: where several contributors disagree with the map alike.
    Alarms,
    /// Compare the map at two epochs: which tiles and how many cells differ.
    Diff {
        /// The earlier epoch.
        from: u64,
        /// The later epoch.
        to: u64,
    },
    /// Roll the map back to an epoch: exclude all uploads and imports after it.
    Rollback {
        /// The last epoch whose record still counts.
        epoch: u64,
        #[command(flatten)]
        how: HowDecided,
    },
    /// Undo a rollback, a revocation or an undoing: what it took back counts again.
    Undo {
        /// The decision's epoch, as `echofix map history` lists it.
        decision: u64,
        #[command(flatten)]
        how: HowDecided,
    },
    /// Exclude what a contributor has uploaded so far, or one upload or imported file.
    #[command(group = clap::ArgGroup::new("whose").required(true))]
    Revoke {
        /// The pseudonym under which the contributor uploads.
        #[arg(long, group = "whose")]
        contributor: Option<String>,
        /// The contributor's keyed hash, as `echofix map quarantine` and `history` tell it.
        #[arg(long, group = "whose")]
        contributor_hash: Option<String>,
        /// The id of an upload or an imported file.
        #[arg(long, group = "whose")]
        upload: Option<String>,
        #[command(flatten)]
        how: HowDecided,
    },
    /// Write the tiles of a region to a file.
    Export {
        /// The file to write. It must not exist yet.
        file: PathBuf,
        /// The region as west,south,east,north in degrees. Without it: the whole map.
        #[arg(long = "box", allow_hyphen_values = true)]
        area: Option<String>,
    },
    /// Add an exported region to the map. A file counts once, however often it is imported.
    Import {
        /// The file that `export` wrote.
        file: PathBuf,
    },
    /// Read everything that the service stores, and check it.
    Verify {
        /// Also fold the journal again, and compare the result with the map that is served.
        #[arg(long)]
        replay: bool,
    },
    /// Compact the journal: replace the records before a day by a checkpoint. This cannot be undone.
    ///
    /// The journal takes less room then, but what came before that day can no longer be rolled back or revoked.
    Compact {
        /// The day, as a UTC date like 2026-12-31. Records of this day and later ones stay as they are.
        #[arg(long)]
        before: String,
        #[command(flatten)]
        how: HowDecided,
    },
    /// Write a backup of the store to a tar archive, while the service runs.
    ///
    /// To restore it, unpack it into an empty data directory. Keep it secret: it holds the key with which contributors are
    /// hashed.
    Backup {
        /// The archive to write. It must not exist yet.
        file: PathBuf,
    },
    /// Bring the map of a data directory into an empty bucket, for services that share it. No service may use either.
    ///
    /// The directory stays as it is. Done again after a failure it goes on.
    Migrate {
        /// The data directory.
        data_dir: PathBuf,
        /// The bucket: `s3://bucket/prefix`. Credentials come from AWS_* in the environment.
        url: String,
    },
}

/// Runs an operation against the HTTP port.
///
/// # Errors
/// When the service cannot be reached or refuses, a file cannot be read or written, or `verify` finds damage.
pub fn run(
    operation: &MapOperation,
    http: &str,
    credentials: &Credentials,
    json: bool,
) -> anyhow::Result<()> {
    let port = OperatorsPort::at(http, credentials)?;
    let decided = |route: &str, body, how: &_| decide(route, body, how, |path, body| port.post(path, body));
    let body = match operation {
        MapOperation::History { limit } => {
            let body = port.get(&format!("history?limit={limit}"))?;
            return show(&body, json, shown::history);
        }
        MapOperation::Migrate { data_dir, url } => {
            let body = json!({ "epoch": SharedMap::at(url)?.migrate(data_dir)? });
            return show(&body, json, |body| {
                println!("the bucket holds the map up to epoch {}", body["epoch"]);
            });
        }
        MapOperation::Quarantine => return show(&port.get("quarantine")?, json, shown::quarantine),
        MapOperation::Alarms => {
            let mut body = port.get("quarantine")?;
            if let Some(parts) = body.as_object_mut() {
                parts.remove("uploads");
            }
            return show(&body, json, shown::alarms);
        }
        MapOperation::Diff { from, to } => {
            let body = port.get(&format!("diff?from={from}&to={to}"))?;
            return show(&body, json, shown::diff);
        }
        MapOperation::Verify { replay } => {
            // Folding the journal again is work, which no GET starts.
            let body =
                if *replay { port.post("verify?replay=true", &json!({}))? } else { port.get("verify")? };
            show(&body, json, shown::verified)?;
            // Scripts read the exit code.
            ensure!(body["sound"] == true, "the store is damaged");
            return Ok(());
        }
        MapOperation::Export { file, area } => {
            let query = area.as_ref().map(|area| format!("?box={area}")).unwrap_or_default();
            let body = json!({ "bytes": port.download(&format!("export{query}"), file, 0o644)? });
            return show(&body, json, shown::written);
        }
        MapOperation::Backup { file } => {
            let body = json!({ "bytes": port.download("backup", file, 0o600)? });
            return show(&body, json, shown::written);
        }
        MapOperation::Import { file } => return show(&port.import(file)?, json, shown::imported),
        MapOperation::Rollback { epoch, how } => decided("rollback", json!({ "epoch": epoch }), how)?,
        MapOperation::Undo { decision, how } => decided("undo", json!({ "decision": decision }), how)?,
        MapOperation::Revoke { contributor: Some(name), how, .. } => {
            decided("revoke", json!({ "contributor": name }), how)?
        }
        MapOperation::Revoke { contributor_hash: Some(hash), how, .. } => {
            decided("revoke", json!({ "contributor_hash": hash }), how)?
        }
        MapOperation::Revoke { upload, how, .. } => decided("revoke", json!({ "upload": upload }), how)?,
        MapOperation::Compact { before, how } => decided("compact", json!({ "before": before }), how)?,
    };
    show(&body, json, shown::decided)
}

fn show(body: &Value, json: bool, people: impl FnOnce(&Value)) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string(body)?);
    } else {
        people(body);
    }
    Ok(())
}

/// The service's HTTP port, which serves operators.
struct OperatorsPort {
    agent: ureq::Agent,
    root: String,
}

impl OperatorsPort {
    fn at(http: &str, credentials: &Credentials) -> anyhow::Result<Self> {
        let root = format!("{}/api/v1/map", http.trim_end_matches('/'));
        Ok(Self { agent: credentials.agent(http, WITHIN)?, root })
    }

    fn get(&self, path: &str) -> anyhow::Result<Value> {
        let url = format!("{}/{path}", self.root);
        read(&url, self.agent.get(&url).call())
    }

    fn post(&self, path: &str, body: &Value) -> anyhow::Result<Value> {
        let url = format!("{}/{path}", self.root);
        read(&url, self.agent.post(&url).send_json(body))
    }

    fn import(&self, file: &Path) -> anyhow::Result<Value> {
        let url = format!("{}/import", self.root);
        let opened = File::open(file).with_context(|| format!("cannot read {}", file.display()))?;
        let request = self.agent.post(&url).header("content-type", "application/octet-stream");
        read(&url, request.send(SendBody::from_owned_reader(BufReader::new(opened))))
    }

    /// Writes an answer to a new file, and removes the file again unless all of the answer came.
    fn download(&self, path: &str, file: &Path, mode: u32) -> anyhow::Result<u64> {
        let url = format!("{}/{path}", self.root);
        let mut answer = answered(&url, self.agent.get(&url).call())?;
        let writing = || format!("cannot write {}", file.display());
        let mut out =
            OpenOptions::new().create_new(true).write(true).mode(mode).open(file).with_context(writing)?;
        // Nobody shall take a part for the whole.
        let begun = Unfinished::begin(file);
        let copied = io::copy(&mut answer.body_mut().as_reader(), &mut out).and_then(|bytes| {
            out.sync_all()?;
            Ok(bytes)
        });
        let bytes = copied.with_context(|| format!("{url} did not send all of it to {}", file.display()))?;
        begun.finish();
        Ok(bytes)
    }
}

fn read(url: &str, answer: Result<Response<Body>, ureq::Error>) -> anyhow::Result<Value> {
    let mut answer = answered(url, answer)?;
    answer.body_mut().read_json().with_context(|| format!("{url} did not answer with JSON"))
}

/// An answer that is not a refusal.
fn answered(url: &str, answer: Result<Response<Body>, ureq::Error>) -> anyhow::Result<Response<Body>> {
    let mut answer = answer.with_context(|| {
        format!("no service answers at {url}; is it running there? Start one with `echofix serve`")
    })?;
    if answer.status().is_success() {
        return Ok(answer);
    }
    let status = answer.status();
    let body: Option<Value> = answer.body_mut().read_json().ok();
    match body.as_ref().and_then(|body| body["error"]["message"].as_str()) {
        Some(reason) => bail!("the service refuses: {reason}"),
        None => bail!("{url} answers {status}"),
    }
}
