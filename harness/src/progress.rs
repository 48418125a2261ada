//! Bars for people, silence for machines.

use std::sync::{Mutex, PoisonError};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// The bar that was begun last, and what it counts.
static LAST: Mutex<Option<(&'static str, ProgressBar)>> = Mutex::new(None);

/// A bar over `length` steps; hidden when `json` is asked for (and, by itself, when the output is
/// not a terminal).
pub fn bar(what: &'static str, length: u64, json: bool) -> ProgressBar {
    let bar = if json {
        ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::hidden())
    } else {
        let style = ProgressStyle::with_template("{msg:<34} {bar:30.cyan} {pos:>5}/{len} {elapsed:>4}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        ProgressBar::new(length).with_style(style).with_message(what)
    };
    *LAST.lock().unwrap_or_else(PoisonError::into_inner) = Some((what, bar.clone()));
    bar
}

/// How far the last bar came, in words; nothing where none was begun, or it is done.
pub fn how_far() -> Option<String> {
    let last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
    let (what, bar) = last.as_ref().filter(|(_, bar)| !bar.is_finished())?;
    Some(match bar.length().filter(|length| *length > 0) {
        Some(length) => format!("{what}: {} of {length}", bar.position()),
        None => what.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: an interrupted command that cannot say how far it came where no bar is drawn, or tells of one that is done.
    #[test]
    fn the_last_bar_says_how_far_it_came() {
        let counted = bar("localizing", 0, true);
        assert_eq!(how_far().as_deref(), Some("localizing"));
        counted.inc_length(120);
        counted.inc(37);
        assert_eq!(how_far().as_deref(), Some("localizing: 37 of 120"));
        counted.finish_and_clear();
        assert_eq!(how_far(), None);
    }
}
