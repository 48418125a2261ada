//! Notes the commit that the command is built from.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-env-changed=ECHOFIX_COMMIT");
    for file in ["HEAD", "logs/HEAD"] {
        // Of a worktree, too, whose own folder is elsewhere.
        if let Some(path) = git(&["rev-parse", "--path-format=absolute", "--git-path", file]) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    let commit = std::env::var("ECHOFIX_COMMIT").ok().or_else(|| git(&["rev-parse", "--short=12", "HEAD"]));
    let commit = commit.unwrap_or_else(|| "commit unknown".to_owned());
    println!("cargo::rustc-env=ECHOFIX_BUILT_FROM={commit}");
}

/// What git says; `None` without git, or outside a repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output =
        Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned()).filter(|text| !text.is_empty())
}
