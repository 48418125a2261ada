//! `echofix status`: whether a running service is ready, and what its map holds.

use echofix_harness::credentials::Credentials;
use echofix_harness::http::get_json_as;
use serde_json::Value;

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
    let map = if args.ready { Value::Null } else { get_json_as(credentials, &args.http, "/api/v1/map")? };
    let reason = map["error"]["message"].as_str().unwrap_or_default();
    anyhow::ensure!(map["error"].is_null(), "the service refuses: {reason}");
    if json {
        println!("{}", serde_json::json!({ "readiness": ready, "map": map }));
    } else {
        print_status(&ready, &map);
    }
    // Scripts and health checks read the exit code.
    anyhow::ensure!(
        ready["ready"] == true,
        "the service is not ready: {}",
        ready["reason"].as_str().unwrap_or("no reason given")
    );
    Ok(())
}

fn print_status(ready: &Value, map: &Value) {
    let state = if ready["ready"] == true { "ready" } else { "not ready" };
    println!(
        "the service is {state}{}",
        ready["reason"].as_str().map(|why| format!(": {why}")).unwrap_or_default()
    );
    if map.is_null() {
        return;
    }
    let (totals, number) = (&map["totals"], |value: &Value| value.as_u64().unwrap_or(0));
    for (word, key) in [("uploads", "uploads"), ("tiles with evidence", "tiles"), ("cells served", "cells")] {
        println!("{word:<20} {:>12}", number(&totals[key]));
    }
    println!("{:<20} {:>12.1}", "kilobytes", number(&totals["bytes"]) as f64 / 1e3);
    if let Some(date) = totals["newest_date"].as_str() {
        println!("{:<20} {date:>12}", "newest evidence");
    }
    println!("{:<20} {:>12}", "epoch", number(&map["epoch"]));
    if number(&totals["tiles"]) > 0 && number(&totals["cells"]) == 0 {
        println!(
            "nothing of it is served yet: every place was seen by fewer contributors than the service's \
             mapping.publish_contributors asks for (`echofix serve --print-config` shows it)"
        );
    }
}
