//! The `echofix` command, built once a test process.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The command. Built on first use, so that no test runs against yesterday's; `ECHOFIX_BINARY` names
/// another one to test, for instance the one of an image.
pub fn echofix() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| std::env::var_os("ECHOFIX_BINARY").map_or_else(build, PathBuf::from))
}

/// Builds it beside the running test, in the same profile.
fn build() -> PathBuf {
    let test = std::env::current_exe().expect("a test has a path");
    // target/<profile>/deps/<test>
    let profile = test.ancestors().nth(2).expect("a test lies in the target directory");
    let target = profile.parent().expect("a profile lies in the target directory");
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["build", "--quiet", "--package", "echofix", "--bin", "echofix", "--target-dir"]).arg(target);
    if profile.ends_with("release") {
        cargo.arg("--release");
    }
    let output = cargo.current_dir(env!("CARGO_MANIFEST_DIR")).output().expect("cargo can be run");
    assert!(output.status.success(), "echofix does not build:\n{}", String::from_utf8_lossy(&output.stderr));
    profile.join("echofix")
}
