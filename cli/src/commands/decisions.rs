//! `echofix map rollback`, `revoke`, `undo`, `compact`: what an operator decides, after it was told what would change.

use std::io::{self, IsTerminal, Write};

use anyhow::{bail, ensure};
use serde_json::{Value, json};

use super::map_shown::foretold;

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
        let foretells = post(route, &question)?;
        if how.dry_run {
            return Ok(foretells);
        }
        let mut out = io::stderr().lock();
        for line in foretold(&foretells["dry_run"]) {
            writeln!(out, "{line}")?;
        }
        drop(out);
        if !agreed()? {
            bail!("nothing was decided");
        }
    }
    post(route, &body)
}

fn agreed() -> io::Result<bool> {
    eprint!("Decide so? Type yes: ");
    let mut answer = String::new();
    io::stdin().read_line(&mut answer)?;
    Ok(answer.trim().eq_ignore_ascii_case("yes"))
}
