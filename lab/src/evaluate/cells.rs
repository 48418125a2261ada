//! Cells of the report's tables: figures with their intervals.

use std::collections::BTreeSet;

use super::record::EpochRecord;
use super::statistics::bootstrap::{Estimate, fraction, percentiles};

/// Fractions of the epochs that a percentile is given for.
pub const FRACTIONS: [f64; 3] = [0.5, 0.95, 0.99];
/// Batches that are this far apart have no scan in common, microseconds.
const APART_US: i64 = 5_000_000;

/// A quantity of a fix; `None` where it is not known.
pub type Quantity = fn(&EpochRecord) -> Option<f64>;

/// Horizontal error, metres.
pub const HORIZONTAL: Quantity = |row| Some(row.error_m());
/// Error along the heading, metres.
pub const ALONG: Quantity = |row| Some(row.along_m.abs());
/// Error across the heading, metres.
pub const CROSS: Quantity = |row| Some(row.cross_m.abs());
/// Error of the heading, degrees.
pub const HEADING: Quantity = |row| Some(row.yaw_deg.abs());
/// Horizontal error against the vehicle's own positioning, metres.
pub const REFERENCE: Quantity = |row| row.reference_m;
/// Error of the heading against the vehicle's own positioning, degrees.
pub const REFERENCE_HEADING: Quantity = |row| row.reference_deg;
/// The map's own error, metres.
pub const FLOOR: Quantity = |row| row.floor_m;
/// Horizontal error without the map's own error, metres.
pub const NET: Quantity = |row| row.net_m;
/// Error of the drifted trajectory's offset, metres.
pub const OFFSET: Quantity = |row| Some(row.offset_m);
/// Error of that offset's heading, degrees.
pub const OFFSET_HEADING: Quantity = |row| Some(row.offset_deg);

/// The cluster of a fix, its world and its block of time. Fixes of different clusters count as independent.
pub fn cluster(row: &EpochRecord) -> (&str, usize) {
    (&row.world, row.block)
}

/// Median, 95 % and 99 % percentiles; empty without rows.
pub fn figures(rows: &[&EpochRecord], quantity: Quantity) -> Vec<Estimate> {
    percentiles(rows.iter().filter_map(|row| Some((quantity(row)?, cluster(row)))), &FRACTIONS)
}

/// The ratio of two figures, with its interval.
pub fn ratio(estimate: &Estimate) -> String {
    format!("{:.3}{}", estimate.value, bounds(estimate, 1.0, 3))
}

/// `50 / 95 / 99` percentiles, the 95 % with its interval.
pub fn cell(rows: &[&EpochRecord], quantity: Quantity, scale: f64, digits: usize) -> String {
    percentiles_cell(&figures(rows, quantity), scale, digits)
}

/// Estimates of the `50 / 95 / 99` percentiles, the 95 % with its interval.
pub fn percentiles_cell(figures: &[Estimate], scale: f64, digits: usize) -> String {
    match figures {
        [p50, p95, p99] => {
            let bounds = bounds(p95, scale, digits);
            let [p50, p95, p99] = [p50, p95, p99].map(|p| scale * p.value);
            format!("{p50:.digits$} / **{p95:.digits$}**{bounds} / {p99:.digits$}")
        }
        _ => "-".to_owned(),
    }
}

/// `50 / 95 / 99` percentiles without the interval.
pub fn short(rows: &[&EpochRecord], quantity: Quantity, scale: f64, digits: usize) -> String {
    match figures(rows, quantity).as_slice() {
        [p50, p95, p99] => {
            let [p50, p95, p99] = [p50, p95, p99].map(|p| scale * p.value);
            format!("{p50:.digits$} / **{p95:.digits$}** / {p99:.digits$}")
        }
        _ => "-".to_owned(),
    }
}

/// An interval in brackets, after a blank; empty where it is not known.
pub fn bounds(estimate: &Estimate, scale: f64, digits: usize) -> String {
    let [low, high] = [estimate.low, estimate.high].map(|v| scale * v);
    if low.is_nan() { String::new() } else { format!(" ({low:.digits$} - {high:.digits$})") }
}

/// The fraction of the rows that are hits, in percent with its interval.
///
/// If no row is a hit, the upper bound is the rule of three over the batches that have no scan in common.
pub fn percent(rows: &[&EpochRecord], hit: impl Fn(&EpochRecord) -> bool) -> String {
    let apart: BTreeSet<_> = rows.iter().map(|row| (&row.world, row.time_us / APART_US)).collect();
    let found = fraction(rows.iter().map(|row| (hit(row), cluster(row))));
    percent_cell(found.map(|found| with_rule_of_three(found, apart.len())))
}

/// A fraction whose interval, if there was no hit, is that of the rule of three over so many independent trials.
pub fn with_rule_of_three(found: Estimate, apart: usize) -> Estimate {
    if found.value > 0.0 {
        return found;
    }
    Estimate { low: 0.0, high: (3.0 / apart as f64).min(1.0), ..found }
}

/// A fraction in percent with its interval; a dash without one.
pub fn percent_cell(found: Option<Estimate>) -> String {
    found.map_or_else(
        || "-".to_owned(),
        |found| format!("{:.1} %{}", 100.0 * found.value, bounds(&found, 100.0, 1)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Vec<EpochRecord> {
        let row = |k: usize| EpochRecord {
            world: "w".to_owned(),
            block: k / 10,
            time_us: k as i64 * 1_000_000,
            along_m: k as f64 * 0.01,
            ..EpochRecord::default()
        };
        (1..=100).map(row).collect()
    }

    #[test]
    fn cells_give_percentiles_in_the_unit_asked_for() {
        let rows = rows();
        let rows: Vec<_> = rows.iter().collect();
        assert_eq!(short(&rows, ALONG, 100.0, 0), "50 / **95** / 99");
        assert!(cell(&rows, ALONG, 100.0, 0).starts_with("50 / **95** ("));
        assert_eq!((cell(&rows, FLOOR, 1.0, 0), short(&[], ALONG, 1.0, 0)), ("-".to_owned(), "-".to_owned()));
        assert!(cell(&rows[..5], ALONG, 1.0, 2).starts_with("0.03 / **0.05** / "));
    }

    #[test]
    fn what_never_happened_may_still_happen() {
        let rows = rows();
        let rows: Vec<_> = rows.iter().collect();
        // 100 s contain 21 batches that have no scan in common (the first and the last one are cut).
        assert_eq!(percent(&rows, |_| false), "0.0 % (0.0 - 14.3)");
        assert!(percent(&rows, |row| row.along_m > 0.5).starts_with("50.0 % ("));
        assert_eq!(percent(&[], |_| true), "-");
    }
}
