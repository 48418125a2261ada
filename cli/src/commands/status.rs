//! `echofix status`: whether a running service is ready, and what its map holds.

use echofix_harness::credentials::Credentials;
use echofix_harness::http::get_json_as;

/// Arguments of `echofix status`.
#[derive(clap::Args)]
pub struct Args {
    /// URL of the service's HTTP port.
    #[arg(long, env = "ECHOFIX_HTTP", default_value = "http://127.0.0.1:8080")]
    http: String,
    /// Ask only whether the service is ready, which anybody may know; the map's figures take the role viewer.
    #[arg(long)]
    ready: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// When the service cannot be reached, is not ready, or does not answer with JSON.
pub fn run(args: &Args, credentials: &Credentials, json: bool) -> anyhow::Result<()> {
    let ready = get_json_as(credentials, &args.http, "/readyz")?;
    let map = if args.ready {
        serde_json::Value::Null
    } else {
        get_json_as(credentials, &args.http, "/api/v1/map")?
    };
    let refused = ["unauthenticated", "role_missing"].iter().any(|code| map["error"]["code"] == *code);
    let reason = map["error"]["message"].as_str().unwrap_or_default();
    anyhow::ensure!(!refused, "the service refuses: {reason}");
    if json {
        println!("{}", serde_json::json!({ "readiness": ready, "map": map }));
    } else {
        println!("{}", serde_json::to_string_pretty(&ready)?);
        println!("{}", serde_json::to_string_pretty(&map)?);
    }
    // Scripts and health checks read the exit code.
    anyhow::ensure!(
        ready["ready"] == true,
        "the service is not ready: {}",
        ready["reason"].as_str().unwrap_or("no reason given")
    );
    Ok(())
}
