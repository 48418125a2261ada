//! What is written to standard error. No line names a contributor.

use std::ffi::OsStr;
use std::io::IsTerminal;

use opentelemetry_otlp::ExporterBuildError;
use tracing_subscriber::filter::ParseError;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

use crate::access_log;
use crate::config::{LogConfig, LogFormat};
use crate::export::{self, Exporting, TraceConfig};

/// Why nothing can be told.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The filter cannot be read.
    #[error("`log.filter`: {0}")]
    Filter(#[from] ParseError),
    /// The collector's address is none.
    #[error("`trace.otlp_endpoint`: {0}")]
    Export(#[from] ExporterBuildError),
}

/// Sends events to standard error from now on, and spans to a collector where one is configured. A second call changes nothing.
/// Call it within a runtime.
///
/// # Errors
/// When the filter or the collector's address cannot be read.
pub fn init(config: &LogConfig, trace: &TraceConfig) -> Result<Option<Exporting>, Error> {
    let access = if config.access { "info" } else { "off" };
    let filter = EnvFilter::builder().parse(&config.filter)?;
    let filter = filter.add_directive(format!("{}={access}", access_log::TARGET).parse()?);
    // Parts of calls are for the collector alone.
    let filter = filter.add_directive(format!("{}=off", export::TARGET).parse()?);
    let no_color = std::env::var_os("NO_COLOR");
    let ansi = is_coloured(std::io::stderr().is_terminal(), no_color.as_deref());
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_ansi(ansi);
    // Where the disk is full that the log goes to, that must not end the thread that writes a line.
    let lines = lines.log_internal_errors(false);
    let lines = match config.format {
        LogFormat::Text => lines.boxed(),
        LogFormat::Json => lines.json().flatten_event(true).boxed(),
    };
    let exporting = Exporting::begin(trace)?;
    let lines = tracing_subscriber::registry().with(lines.with_filter(filter));
    // A program that embeds the service may have set up its own: that one stays.
    let _ = match &exporting {
        None => lines.try_init(),
        Some(exporting) => lines.with(exporting.layer()).try_init(),
    };
    Ok(exporting)
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
