//! Tables of the report, in Markdown.

use std::fmt::Write as _;

use super::cells::{
    ALONG, CROSS, FLOOR, HEADING, HORIZONTAL, NET, OFFSET, OFFSET_HEADING, Quantity, REFERENCE,
    REFERENCE_HEADING, bounds, cell, cluster, figures, percent, short,
};
use super::groups::{Groups, usable};
use super::record::EpochRecord;
use super::statistics::bootstrap::Estimate;
use super::statistics::calibration::{CHI2_95_2, CHI2_95_3, calibration};

/// The paper's alert limit, metres.
pub const ALERT_M: f64 = 0.5;

/// A table with the groups' names in its first column. Groups without a line are left out.
fn table(
    groups: &Groups<'_>,
    columns: &[&str],
    line: impl Fn(&[&EpochRecord]) -> Option<Vec<String>>,
) -> String {
    let mut table = format!("| | {} |\n|{}\n", columns.join(" | "), "---|".repeat(columns.len() + 1));
    for (name, rows) in groups {
        if let Some(cells) = line(rows) {
            let _ = writeln!(table, "| {name} | {} |", cells.join(" | "));
        }
    }
    table
}

/// Errors of each group.
pub fn errors(groups: &Groups<'_>) -> String {
    let columns = [
        "fixes",
        "horizontal, cm",
        "along, cm",
        "across, cm",
        "heading, deg",
        "off by > 50 cm",
        "wrong by > 1 m",
        "map's own error, cm",
        "as the paper measures: horizontal, cm",
        "heading, deg",
    ];
    table(groups, &columns, |rows| {
        Some(vec![
            rows.len().to_string(),
            cell(rows, HORIZONTAL, 100.0, 0),
            cell(rows, ALONG, 100.0, 0),
            cell(rows, CROSS, 100.0, 0),
            cell(rows, HEADING, 1.0, 2),
            percent(rows, |row| row.error_m() > ALERT_M),
            percent(rows, EpochRecord::wrong),
            cell(rows, FLOOR, 100.0, 0),
            cell(rows, REFERENCE, 100.0, 0),
            cell(rows, REFERENCE_HEADING, 1.0, 2),
        ])
    })
}

/// Errors and usability of each group, for the variations of one quantity.
pub fn sweep(groups: &Groups<'_>) -> String {
    let columns = [
        "horizontal, cm",
        "along, cm",
        "across, cm",
        "heading, deg",
        "off by > 50 cm",
        "wrong by > 1 m",
        "usable",
        "wrong, of the usable",
        "map's own error, cm",
    ];
    table(groups, &columns, |rows| {
        Some(vec![
            cell(rows, HORIZONTAL, 100.0, 0),
            short(rows, ALONG, 100.0, 0),
            short(rows, CROSS, 100.0, 0),
            cell(rows, HEADING, 1.0, 2),
            percent(rows, |row| row.error_m() > ALERT_M),
            percent(rows, EpochRecord::wrong),
            percent(rows, |row| row.usable),
            percent(&usable(rows), EpochRecord::wrong),
            short(rows, FLOOR, 100.0, 0),
        ])
    })
}

/// Errors of the trajectory's offset, as the paper measures them, beside those of the newest pose.
pub fn drifted(groups: &Groups<'_>) -> String {
    let columns = [
        "offset, cm",
        "offset's heading, deg",
        "newest pose, cm",
        "along, cm",
        "across, cm",
        "its heading, deg",
        "wrong by > 1 m",
        "usable",
        "wrong, of the usable",
    ];
    table(groups, &columns, |rows| {
        Some(vec![
            cell(rows, OFFSET, 100.0, 0),
            cell(rows, OFFSET_HEADING, 1.0, 2),
            cell(rows, HORIZONTAL, 100.0, 0),
            short(rows, ALONG, 100.0, 0),
            short(rows, CROSS, 100.0, 0),
            short(rows, HEADING, 1.0, 2),
            percent(rows, EpochRecord::wrong),
            percent(rows, |row| row.usable),
            percent(&usable(rows), EpochRecord::wrong),
        ])
    })
}

/// Verdicts and protection levels of each group, beside the errors.
pub fn integrity(groups: &Groups<'_>) -> String {
    let columns = [
        "usable",
        "wrong by > 1 m, all",
        "of the usable",
        "usable: horizontal, cm",
        "usable: heading, deg",
        "usable: beyond protection",
        "usable: protection level, cm",
        "all, without the map's error, cm",
    ];
    table(groups, &columns, |rows| {
        let good = usable(rows);
        let leveled: Vec<_> = good.iter().copied().filter(|row| row.protection_m().is_some()).collect();
        Some(vec![
            percent(rows, |row| row.usable),
            percent(rows, EpochRecord::wrong),
            percent(&good, EpochRecord::wrong),
            cell(&good, HORIZONTAL, 100.0, 0),
            cell(&good, HEADING, 1.0, 2),
            percent(&leveled, EpochRecord::beyond_protection),
            short(&leveled, EpochRecord::protection_m, 100.0, 0),
            cell(rows, NET, 100.0, 0),
        ])
    })
}

/// Normalised errors of the groups with a covariance; usable fixes only.
pub fn covariance(groups: &Groups<'_>) -> String {
    let columns = [
        "NEES of the position / 2",
        "inside its 95 % ellipse",
        "NEES with heading / 3",
        "inside its 95 % ellipsoid",
    ];
    table(groups, &columns, |rows| {
        let good = usable(rows);
        let mut cells = Vec::new();
        for (nees, freedom, chi2_95) in
            [((|row| row.nees_2) as Quantity, 2.0, CHI2_95_2), (|row| row.nees_3, 3.0, CHI2_95_3)]
        {
            let sample: Vec<_> = good.iter().filter_map(|row| Some((nees(row)?, cluster(row)))).collect();
            let found = calibration(&sample, freedom, chi2_95)?;
            let show = |e: &Estimate, scale, digits| format!("{:.digits$}", scale * e.value);
            cells.push(format!("{}{}", show(&found.mean, 1.0, 2), bounds(&found.mean, 1.0, 2)));
            cells.push(format!("{} %{}", show(&found.inside, 100.0, 1), bounds(&found.inside, 100.0, 1)));
        }
        Some(cells)
    })
}

/// Wrong and usable answers where many positions look alike.
pub fn ambiguity(groups: &Groups<'_>) -> String {
    let columns = [
        "fixes",
        "wrong by > 1 m",
        "usable",
        "wrong, of the usable",
        "relative score of the alternative, median",
    ];
    table(groups, &columns, |rows| {
        let second = figures(rows, |row| Some(row.second));
        Some(vec![
            rows.len().to_string(),
            percent(rows, EpochRecord::wrong),
            percent(rows, |row| row.usable),
            percent(&usable(rows), EpochRecord::wrong),
            second.first().map_or_else(|| "-".to_owned(), |median| format!("{:.2}", median.value)),
        ])
    })
}

/// Number of the batches' cells, and milliseconds of a fix.
pub fn costs(groups: &Groups<'_>) -> String {
    table(groups, &["cells of a batch", "ms a fix"], |rows| {
        Some(vec![short(rows, |row| Some(row.cells as f64), 1.0, 0), short(rows, |row| Some(row.ms), 1.0, 0)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::groups::{methods, of_method};

    #[test]
    fn every_table_has_a_line_a_group_and_a_cell_a_column() {
        let row = |k: usize| EpochRecord {
            world: "w".to_owned(),
            block: k,
            method: if k.is_multiple_of(2) { "a" } else { "b" },
            along_m: 0.1,
            usable: !k.is_multiple_of(3),
            nees_2: Some(2.0),
            nees_3: Some(3.0),
            protection_along_m: Some(0.3),
            protection_cross_m: Some(0.4),
            ..EpochRecord::default()
        };
        let rows: Vec<EpochRecord> = (0..60).map(row).collect();
        let rows: Vec<_> = rows.iter().collect();
        assert_eq!(methods(&rows), ["a", "b"]);
        let groups: Groups<'_> = ["a", "b"].map(|name| (name.to_owned(), of_method(&rows, name))).into();
        for shown in
            [errors, sweep, drifted, integrity, covariance, ambiguity, costs].map(|table| table(&groups))
        {
            let lines: Vec<_> = shown.lines().collect();
            assert_eq!(lines.len(), 4, "{shown}");
            let bars = |line: &str| line.matches('|').count();
            assert!(lines.iter().all(|line| bars(line) == bars(lines[0])), "{shown}");
            assert!(!shown.contains("NaN"), "{shown}");
        }
        assert!(integrity(&groups).contains("50 / **50** / 50"));
        assert!(covariance(&groups).contains("| a | 1.00 (1.00 - 1.00) | 100.0 % "));
    }
}
