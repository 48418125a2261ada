//! `echofix map rollback`, `revoke`, `undo`, `compact`: what an operator decides, after it was told what would change.

use std::io::{self, IsTerminal, Write};

use anyhow::{bail, ensure};
use serde_json::{Value, json};

/// How a decision is taken.
#[derive(clap::Args)]
pub struct HowDecided {
    /// Decide without asking. Needed where nobody can be asked, as in a script.
    #[arg(long)]
    yes: bool,
    /// Only tell what would change.
    #[arg(long, conflicts_with = "yes")]
    dry_run: bool,
    /// Why. The journal keeps it, and `echofix map history` tells it.
    #[arg(long)]
    reason: Option<String>,
}

/// Tells what a decision would change, asks, and decides. `post` sends a body to a route.
///
/// # Errors
/// When the service refuses, or nobody said yes.
pub fn decide(
    route: &str,
    mut body: Value,
    how: &HowDecided,
    post: impl Fn(&str, &Value) -> anyhow::Result<Value>,
) -> anyhow::Result<Value> {
    if let Some(reason) = &how.reason {
        body["reason"] = json!(reason);
    }
    if !how.yes {
        let asked = how.dry_run || io::stdin().is_terminal();
        ensure!(asked, "nobody can be asked here: say --yes to decide, or --dry-run to look");
        let mut question = body.clone();
        question["dry_run"] = json!(true);
        let foretold = post(route, &question)?;
        if how.dry_run {
            return Ok(foretold);
        }
        tell(&foretold["dry_run"])?;
        if !agreed()? {
            bail!("nothing was decided");
        }
    }
    post(route, &body)
}

fn tell(change: &Value) -> io::Result<()> {
    let mut out = io::stderr().lock();
    let pair = |of: &Value| format!("{} taken back, {} given back", of["taken_back"], of["given_back"]);
    writeln!(
        out,
        "uploads:        {} (of {} contributors)",
        pair(&change["uploads"]),
        change["contributors"]
    )?;
    writeln!(out, "imported tiles: {}", pair(&change["imported_tiles"]))?;
    let cells = &change["cells"];
    writeln!(
        out,
        "cells:          {} added, {} removed, {} changed, in {} tiles",
        cells["added"], cells["removed"], cells["changed"], change["tiles_changed"]
    )?;
    if change["can_be_undone"] == true {
        writeln!(out, "`echofix map undo` takes this back.")
    } else {
        writeln!(out, "{} uploads are compacted. This CANNOT be undone.", change["compacted"])
    }
}

fn agreed() -> io::Result<bool> {
    eprint!("Decide so? Type yes: ");
    let mut answer = String::new();
    io::stdin().read_line(&mut answer)?;
    Ok(answer.trim().eq_ignore_ascii_case("yes"))
}
