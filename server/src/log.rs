//! What is written to standard error. No line names a contributor.

use std::ffi::OsStr;
use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::ParseError;

use crate::access_log;
use crate::config::{LogConfig, LogFormat};

/// Sends events to standard error from now on. A second call changes nothing.
///
/// # Errors
/// When the filter cannot be read.
pub fn init(config: &LogConfig) -> Result<(), ParseError> {
    let access = if config.access { "info" } else { "off" };
    let filter = EnvFilter::builder().parse(&config.filter)?;
    let filter = filter.add_directive(format!("{}={access}", access_log::TARGET).parse()?);
    let no_color = std::env::var_os("NO_COLOR");
    let ansi = is_coloured(std::io::stderr().is_terminal(), no_color.as_deref());
    let lines =
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(ansi);
    // Where the disk is full that the log goes to, that must not end the thread that writes a line.
    let lines = lines.log_internal_errors(false);
    // A program that embeds the service may have set up its own: that one stays.
    let _ = match config.format {
        LogFormat::Text => lines.try_init(),
        LogFormat::Json => lines.json().flatten_event(true).try_init(),
    };
    Ok(())
}

/// Colours are for terminals, and for who does not forbid them (<https://no-color.org>): an empty variable forbids nothing.
fn is_coloured(terminal: bool, no_color: Option<&OsStr>) -> bool {
    terminal && no_color.is_none_or(OsStr::is_empty)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: control characters in files and pipes, and on a terminal that forbids them.
    #[test]
    fn colours_are_for_terminals_that_take_them() {
        assert!(is_coloured(true, None) && is_coloured(true, Some(OsStr::new(""))));
        assert!(!is_coloured(true, Some(OsStr::new("1"))) && !is_coloured(false, None));
    }
}
