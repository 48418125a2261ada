//! Bars for people, silence for machines.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `length` steps; hidden when `json` is asked for (and, by itself, when the output is
/// not a terminal).
pub fn bar(what: &'static str, length: u64, json: bool) -> ProgressBar {
    if json {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg:<34} {bar:30.cyan} {pos:>5}/{len} {elapsed:>4}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length).with_style(style).with_message(what)
}
