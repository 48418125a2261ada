//! Tables of the report, in Markdown.

use std::fmt::Write as _;

use super::record::Record;
use super::statistics::bootstrap::{Estimate, percentiles, share};
use super::statistics::calibration::{CHI2_95_2, CHI2_95_3, Calibration, calibration};

/// Shares of the epochs that a percentile is given for.
const SHARES: [f64; 3] = [0.5, 0.95, 0.99];

/// What is independent: (world, block of time).
type Cluster<'a> = (&'a str, usize);

fn cluster(row: &Record) -> Cluster<'_> {
    (&row.world, row.block)
}

/// Rows of one method, in the order they came.
pub fn of_method<'a>(rows: &[&'a Record], method: &str) -> Vec<&'a Record> {
    rows.iter().copied().filter(|row| row.method == method).collect()
}

/// Methods in the order of the tables.
pub fn methods(rows: &[&Record]) -> Vec<&'static str> {
    let mut names = Vec::new();
    for row in rows {
        if !names.contains(&row.method) {
            names.push(row.method);
        }
    }
    names
}

/// A quantity of a row, for percentiles.
type Quantity = fn(&Record) -> Option<f64>;

/// Percentiles of a quantity, with their intervals.
fn figures(rows: &[&Record], quantity: Quantity) -> Vec<Estimate> {
    percentiles(rows.iter().filter_map(|row| Some((quantity(row)?, cluster(row)))), &SHARES)
}

/// `50 / 95 / 99` percentiles with the interval of the 95 %.
fn cell(rows: &[&Record], quantity: Quantity, scale: f64, digits: usize) -> String {
    match figures(rows, quantity).as_slice() {
        [p50, p95, p99] => {
            let [p50, low, high, p95, p99] =
                [p50.value, p95.low, p95.high, p95.value, p99.value].map(|v| scale * v);
            format!("{p50:.digits$} / **{p95:.digits$}** ({low:.digits$} - {high:.digits$}) / {p99:.digits$}")
        }
        _ => "-".to_owned(),
    }
}

const HORIZONTAL: Quantity = |row| Some(row.error_m());
const ALONG: Quantity = |row| Some(row.along_m.abs());
const CROSS: Quantity = |row| Some(row.cross_m.abs());
const HEADING: Quantity = |row| Some(row.yaw_deg.abs());
const FLOOR: Quantity = |row| row.floor_m;
const NET: Quantity = |row| row.net_m;
const OFFSET: Quantity = |row| Some(row.offset_m);
const OFFSET_HEADING: Quantity = |row| Some(row.offset_deg);

/// A share in percent with its interval.
pub fn percent(estimate: Option<Estimate>) -> String {
    estimate.map_or_else(
        || "-".to_owned(),
        |Estimate { value, low, high }| {
            format!("{:.1} % ({:.1} - {:.1})", 100.0 * value, 100.0 * low, 100.0 * high)
        },
    )
}

fn wrong(rows: &[&Record]) -> String {
    percent(share(rows.iter().map(|row| (row.wrong(), cluster(row)))))
}

fn usable<'a>(rows: &[&'a Record]) -> Vec<&'a Record> {
    rows.iter().copied().filter(|row| row.usable).collect()
}

/// Groups of rows with a name each: the lines of a table.
pub type Groups<'a> = Vec<(String, Vec<&'a Record>)>;

/// Errors of each group.
pub fn errors(groups: &Groups<'_>) -> String {
    let mut table = String::from(
        "| | fixes | horizontal, cm | along, cm | across, cm | heading, deg | off by > 50 cm | wrong by > 1 m | map's own error, cm |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for (name, rows) in groups {
        let [horizontal, along, cross, floor] =
            [HORIZONTAL, ALONG, CROSS, FLOOR].map(|quantity| cell(rows, quantity, 100.0, 0));
        let (heading, wrong, count) = (cell(rows, HEADING, 1.0, 2), wrong(rows), rows.len());
        let off = percent(share(rows.iter().map(|row| (row.error_m() > 0.5, cluster(row)))));
        let _ = writeln!(
            table,
            "| {name} | {count} | {horizontal} | {along} | {cross} | {heading} | {off} | {wrong} | {floor} |"
        );
    }
    table
}

/// Errors of the trajectory's offset (the paper's, with drift) beside those of the newest pose.
pub fn drifted(groups: &Groups<'_>) -> String {
    let mut table = String::from(
        "| | fixes | offset, cm | offset's heading, deg | newest pose, cm | its heading, deg | wrong by > 1 m |\n|---|---|---|---|---|---|---|\n",
    );
    for (name, rows) in groups {
        let [offset, horizontal] = [OFFSET, HORIZONTAL].map(|quantity| cell(rows, quantity, 100.0, 0));
        let [turn, heading] = [OFFSET_HEADING, HEADING].map(|quantity| cell(rows, quantity, 1.0, 2));
        let (count, wrong) = (rows.len(), wrong(rows));
        let _ = writeln!(table, "| {name} | {count} | {offset} | {turn} | {horizontal} | {heading} | {wrong} |");
    }
    table
}

/// What the methods say of themselves, beside what is true.
pub fn integrity(groups: &Groups<'_>) -> String {
    let mut table = String::from(
        "| | usable | wrong by > 1 m, all | of the usable | usable: horizontal, cm | usable: heading, deg | beyond protection | without the map's error, cm |\n|---|---|---|---|---|---|---|---|\n",
    );
    for (name, rows) in groups {
        let good = usable(rows);
        let available = percent(share(rows.iter().map(|row| (row.usable, cluster(row)))));
        let leveled = good.iter().filter(|row| row.protection_m().is_some());
        let beyond = percent(share(leveled.map(|row| (row.beyond_protection(), cluster(row)))));
        let [horizontal, net] = [(&good, HORIZONTAL), (rows, NET)].map(|(rows, q)| cell(rows, q, 100.0, 0));
        let (heading, all, of_usable) = (cell(&good, HEADING, 1.0, 2), wrong(rows), wrong(&good));
        let _ = writeln!(
            table,
            "| {name} | {available} | {all} | {of_usable} | {horizontal} | {heading} | {beyond} | {net} |"
        );
    }
    table
}

/// Normalised errors of the methods that give a covariance, usable fixes only.
pub fn covariance(groups: &Groups<'_>) -> String {
    let mut table = String::from(
        "| | NEES of the position / 2 | inside its 95 % ellipse | NEES with heading / 3 | inside its 95 % ellipsoid |\n|---|---|---|---|---|\n",
    );
    for (name, rows) in groups {
        let good = usable(rows);
        let of = |nees: Quantity| -> Vec<_> {
            good.iter().filter_map(|row| Some((nees(row)?, cluster(row)))).collect()
        };
        let two = calibration(&of(|row| row.nees_2), 2.0, CHI2_95_2);
        let three = calibration(&of(|row| row.nees_3), 3.0, CHI2_95_3);
        if let (Some(two), Some(three)) = (two, three) {
            let show = |Calibration { mean: Estimate { value, low, high }, inside }| {
                format!("{value:.2} ({low:.2} - {high:.2}) | {}", percent(Some(inside)))
            };
            let _ = writeln!(table, "| {name} | {} | {} |", show(two), show(three));
        }
    }
    table
}

/// What becomes of answers where places are easily mistaken.
pub fn ambiguity(groups: &Groups<'_>) -> String {
    let mut table = String::from(
        "| | fixes | wrong by > 1 m | usable | wrong, of the usable | relative score of the alternative, median |\n|---|---|---|---|---|---|\n",
    );
    for (name, rows) in groups {
        let (count, all, of_usable) = (rows.len(), wrong(rows), wrong(&usable(rows)));
        let available = percent(share(rows.iter().map(|row| (row.usable, cluster(row)))));
        let second = figures(rows, |row| Some(row.second));
        let second = second.first().map_or(f64::NAN, |median| median.value);
        let _ = writeln!(table, "| {name} | {count} | {all} | {available} | {of_usable} | {second:.2} |");
    }
    table
}

/// Cells of the batches, median, and milliseconds of a fix.
pub fn costs(groups: &Groups<'_>) -> String {
    let mut table = String::from("| | cells of a batch | ms a fix |\n|---|---|---|\n");
    for (name, rows) in groups {
        let cells = cell(rows, |row| Some(row.cells as f64), 1.0, 0);
        let ms = cell(rows, |row| Some(row.ms), 1.0, 0);
        let _ = writeln!(table, "| {name} | {cells} | {ms} |");
    }
    table
}
