//! `echofix status`: what a running service holds and whether it is ready.

use std::time::Duration;

use anyhow::Context;
use serde_json::Value;

/// Arguments of `echofix status`.
#[derive(clap::Args)]
pub struct Args {
    /// Address of the service's HTTP port.
    #[arg(long, env = "ECHOFIX_HTTP", default_value = "http://127.0.0.1:8080")]
    http: String,
}

/// Runs the subcommand.
///
/// # Errors
/// When the service is out of reach, not ready, or answers nonsense.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    let ready = get(&args.http, "/readyz")?;
    let map = get(&args.http, "/api/v1/map")?;
    if json {
        println!("{}", serde_json::json!({ "readiness": ready, "map": map }));
    } else {
        println!("{}", serde_json::to_string_pretty(&ready)?);
        println!("{}", serde_json::to_string_pretty(&map)?);
    }
    // Scripts and health checks go by the exit code.
    anyhow::ensure!(
        ready["ready"] == true,
        "the service is not ready: {}",
        ready["reason"].as_str().unwrap_or("no reason given")
    );
    Ok(())
}

/// The JSON that a path of the service's HTTP port answers with.
///
/// # Errors
/// When the service is out of reach or answers with something else.
pub fn get(http: &str, path: &str) -> anyhow::Result<Value> {
    let url = format!("{}{path}", http.trim_end_matches('/'));
    let agent: ureq::Agent = ureq::Agent::config_builder()
        .timeout_global(Some(Duration::from_secs(10)))
        // 503 with a reason is an answer, too.
        .http_status_as_error(false)
        .build()
        .into();
    let mut answer = agent.get(&url).call().with_context(|| {
        format!("no service answers at {url}; is it running there? Start one with `echofix serve`")
    })?;
    answer.body_mut().read_json().with_context(|| format!("{url} did not answer with JSON"))
}
