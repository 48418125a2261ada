//! Which build runs.

use std::sync::OnceLock;

static BUILT_FROM: OnceLock<&'static str> = OnceLock::new();

/// The version of the service.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Says which commit the program was built from, before the service starts. The first to say so is right.
pub fn set_commit(commit: &'static str) {
    let _ = BUILT_FROM.set(commit);
}

/// The commit that the program was built from: as said, else as `ECHOFIX_COMMIT` was set for the build, else `unknown`.
#[must_use]
pub fn commit() -> &'static str {
    BUILT_FROM.get().copied().unwrap_or(option_env!("ECHOFIX_COMMIT").unwrap_or("unknown"))
}
