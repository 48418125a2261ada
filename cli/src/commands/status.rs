//! `echofix status`: whether a running service is ready, and what its map holds.

use echofix_harness::credentials::Credentials;
use echofix_harness::http::get_json_as;
use serde_json::Value;

use super::map_shown::alarms_of;

/// Arguments of `echofix status`.
#[derive(clap::Args)]
pub struct Args {
    /// URL of the service's HTTP port. Without it, that of the profile, or `http://127.0.0.1:8080`.
    #[arg(long, env = "ECHOFIX_HTTP")]
    http: Option<String>,
    /// Ask only whether the service is ready, which anybody may know; the map's figures take the role viewer.
    #[arg(long)]
    ready: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// When the service cannot be reached, is not ready, or does not answer with JSON.
pub fn run(args: &Args, credentials: &Credentials, json: bool) -> anyhow::Result<()> {
    let http = credentials.http(args.http.as_deref());
    let ready = get_json_as(credentials, http, "/readyz")?;
    let map = if args.ready { Value::Null } else { get_json_as(credentials, http, "/api/v1/map")? };
    let reason = map["error"]["message"].as_str().unwrap_or_default();
    anyhow::ensure!(map["error"].is_null(), "the service refuses: {reason}");
    let quarantine = if args.ready { Value::Null } else { kept_out(credentials, http)? };
    if json {
        let told = serde_json::json!({ "readiness": ready, "map": map, "quarantine": quarantine });
        println!("{told}");
    } else {
        print_status(&ready, &map);
        print_kept_out(&quarantine);
    }
    // Scripts and health checks read the exit code.
    anyhow::ensure!(
        ready["ready"] == true,
        "the service is not ready: {}",
        ready["reason"].as_str().unwrap_or("no reason given")
    );
    Ok(())
}

/// How many uploads are in quarantine, and the alarms; null while the map is made anew, when nobody can say.
fn kept_out(credentials: &Credentials, http: &str) -> anyhow::Result<Value> {
    let mut quarantine = get_json_as(credentials, http, "/api/v1/map/quarantine")?;
    if let Some(parts) = quarantine.as_object_mut() {
        parts.remove("uploads");
    }
    Ok(if quarantine["error"].is_null() { quarantine } else { Value::Null })
}

fn print_kept_out(quarantine: &Value) {
    if let Some(count) = quarantine["quarantined"].as_u64().filter(|count| *count > 0) {
        println!("{:<20} {count:>12}   see `echofix map quarantine`", "in quarantine");
    }
    alarms_of(quarantine).for_each(|line| println!("{line}"));
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
    let waiting = &map["waiting"];
    let of = |key: &str| number(&waiting[key]);
    if let Some(why) = why_waiting((of("tiles"), number(&totals["tiles"])), of("contributors"), of("needed"))
    {
        println!("{why}");
    }
}

/// Why so many tiles `of` all are not served yet, when the most contributors that saw the same in one of them are so many; nothing
/// where none waits.
pub(super) fn why_waiting((tiles, of): (u64, u64), contributors: u64, needed: u64) -> Option<String> {
    if tiles == 0 {
        return None;
    }
    let whole = if tiles == of { "nothing is served yet: " } else { "" };
    let wait = if tiles == 1 { "waits" } else { "wait" };
    let many = format!("{whole}{tiles} of {of} tiles {wait} for more contributors");
    if contributors >= needed {
        return Some(format!("{many}; what was seen there is not confirmed by enough of them"));
    }
    let (have, are) = (
        if contributors == 1 { "contributor has" } else { "contributors have" },
        if needed == 1 { "is" } else { "are" },
    );
    Some(format!(
        "{many}; at most {contributors} {have} seen the same there, and {needed} {are} needed \
         (the service's mapping.publish_contributors)"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a map that is silent about why it is empty, and one that calls a part of it the whole.
    #[test]
    fn what_waits_is_told_with_how_many_are_needed() {
        assert_eq!(why_waiting((0, 5), 0, 3), None);
        let all = why_waiting((5, 5), 1, 3).unwrap();
        assert!(
            all.starts_with("nothing is served yet: 5 of 5 tiles wait") && all.contains("1 contributor has"),
            "{all}"
        );
        let one = why_waiting((1, 5), 2, 3).unwrap();
        assert!(one.starts_with("1 of 5 tiles waits") && one.contains("2 contributors have"), "{one}");
        assert!(one.contains("3 are needed"), "{one}");
        assert!(why_waiting((1, 5), 3, 3).unwrap().contains("not confirmed"));
    }
}
