//! Groups of fixes: the lines of a table.

use super::record::EpochRecord;

/// Groups of fixes with their names: the lines of a table.
pub type Groups<'a> = Vec<(String, Vec<&'a EpochRecord>)>;

/// The fixes of one method, in their order.
pub fn of_method<'a>(rows: &[&'a EpochRecord], method: &str) -> Vec<&'a EpochRecord> {
    rows.iter().copied().filter(|row| row.method == method).collect()
}

/// The methods of these fixes, in the order of the tables.
pub fn methods(rows: &[&EpochRecord]) -> Vec<&'static str> {
    let mut names = Vec::new();
    for row in rows {
        if !names.contains(&row.method) {
            names.push(row.method);
        }
    }
    names
}

/// The usable ones among these fixes.
pub fn usable<'a>(rows: &[&'a EpochRecord]) -> Vec<&'a EpochRecord> {
    rows.iter().copied().filter(|row| row.usable).collect()
}
