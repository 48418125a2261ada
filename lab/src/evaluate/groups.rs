//! Rows that belong together: the lines of a table.

use super::record::Record;

/// Groups of rows with a name each: the lines of a table.
pub type Groups<'a> = Vec<(String, Vec<&'a Record>)>;

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

/// Those that may be used.
pub fn usable<'a>(rows: &[&'a Record]) -> Vec<&'a Record> {
    rows.iter().copied().filter(|row| row.usable).collect()
}
