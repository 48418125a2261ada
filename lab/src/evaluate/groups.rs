//! Rows that belong together: the lines of a table.

use super::record::EpochRecord;

/// Groups of rows with a name each: the lines of a table.
pub type Groups<'a> = Vec<(String, Vec<&'a EpochRecord>)>;

/// Rows of one method, in the order they came.
pub fn of_method<'a>(rows: &[&'a EpochRecord], method: &str) -> Vec<&'a EpochRecord> {
    rows.iter().copied().filter(|row| row.method == method).collect()
}

/// Methods in the order of the tables.
pub fn methods(rows: &[&EpochRecord]) -> Vec<&'static str> {
    let mut names = Vec::new();
    for row in rows {
        if !names.contains(&row.method) {
            names.push(row.method);
        }
    }
    names
}

/// Those that may be used.
pub fn usable<'a>(rows: &[&'a EpochRecord]) -> Vec<&'a EpochRecord> {
    rows.iter().copied().filter(|row| row.usable).collect()
}
