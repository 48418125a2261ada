//! The cells of a row, by the columns that a part of a log has.

use std::fmt::Display;
use std::str::FromStr;

use csv::StringRecord;

use super::super::Problem;
use super::super::stamp::TimeUnit;

/// The column of times.
pub(super) const TIME: &str = "time_us";
/// Names that the column of times may have instead, and the unit they state.
const TIMES: [(&str, TimeUnit); 3] =
    [("time_ns", TimeUnit::Nanoseconds), ("time_ms", TimeUnit::Milliseconds), ("time_s", TimeUnit::Seconds)];

/// Where the columns of a part of a log stand in a file.
pub(super) struct Columns {
    names: &'static [&'static str],
    /// Cells of the header.
    cells: usize,
    at: Vec<Option<usize>>,
    /// The unit that the header states.
    pub stated: Option<TimeUnit>,
    pub unit: TimeUnit,
}

impl Columns {
    /// Finds columns in a header, the first of which are `required`.
    pub(super) fn find(
        header: &StringRecord,
        names: &'static [&'static str],
        required: usize,
    ) -> Result<Self, Problem> {
        if header.len() == 1
            && let Some(separator) = [';', '\t', '|'].into_iter().find(|c| header[0].contains(*c))
        {
            let told = format!(
                "its cells are separated by {separator:?}; separate them by commas, with points in numbers"
            );
            return Err(Problem::Unparsable(told));
        }
        let position = |name: &str| header.iter().position(|cell| bare(cell).eq_ignore_ascii_case(name));
        let mut stated = None;
        let mut at: Vec<Option<usize>> = names.iter().map(|name| position(name)).collect();
        if let (Some(TIME), Some(None)) = (names.first().copied(), at.first())
            && let Some((found, unit)) = TIMES.iter().find_map(|(name, unit)| Some((position(name)?, *unit)))
        {
            (at[0], stated) = (Some(found), Some(unit));
        }
        match (0..required).find(|i| at[*i].is_none()) {
            Some(missing) => Err(Problem::MissingColumn {
                column: names[missing].to_owned(),
                expected: names[..required].join(","),
            }),
            None => Ok(Self { names, cells: header.len(), at, stated, unit: stated.unwrap_or_default() }),
        }
    }
}

/// One row.
pub(super) struct Cells<'a> {
    pub columns: &'a Columns,
    pub record: &'a StringRecord,
}

impl Cells<'_> {
    /// As many cells as the header has, but for empty ones at the end, which some writers add.
    pub(super) fn fit(&self) -> Result<(), Problem> {
        let (found, expected) = (self.record.len(), self.columns.cells);
        let more_are_empty = self.record.iter().skip(expected).all(|cell| bare(cell).is_empty());
        if found < expected || !more_are_empty {
            return Err(Problem::FieldCount { found: found as u64, expected: expected as u64 });
        }
        Ok(())
    }

    fn text(&self, column: usize) -> &str {
        let cell = self.columns.at[column].and_then(|at| self.record.get(at));
        bare(cell.unwrap_or_default())
    }

    /// A number.
    pub(super) fn number<T: FromStr<Err: Display>>(&self, column: usize) -> Result<T, Problem> {
        let text = self.text(column);
        text.parse().map_err(|error: T::Err| self.refused(column, error))
    }

    /// A whole number, also as writers put it that know only fractions: `2.0`.
    pub(super) fn index(&self, column: usize) -> Result<usize, Problem> {
        let text = self.text(column);
        let whole = text.split_once('.').filter(|(_, rest)| rest.bytes().all(|digit| digit == b'0'));
        let text = whole.map_or(text, |(whole, _)| whole);
        text.parse().map_err(|error| self.refused(column, error))
    }

    /// A number, or `None` where nothing stands.
    pub(super) fn given<T: FromStr<Err: Display>>(&self, column: usize) -> Result<Option<T>, Problem> {
        if self.text(column).is_empty() { Ok(None) } else { self.number(column).map(Some) }
    }

    /// A number, or `None` where nothing stands or what stands there says that nothing was measured.
    pub(super) fn optional<T: FromStr<Err: Display>>(&self, column: usize) -> Result<Option<T>, Problem> {
        let nothing = ["", "-", "nan", "-nan", "na", "n/a", "null", "none"];
        let text = self.text(column);
        if nothing.iter().any(|word| text.eq_ignore_ascii_case(word)) {
            return Ok(None);
        }
        self.number(column).map(Some)
    }

    /// The time, microseconds.
    pub(super) fn time_us(&self) -> Result<i64, Problem> {
        let unit = self.columns.unit;
        let time_us = match self.number::<i64>(0) {
            Ok(time) => unit.whole(time),
            Err(refused) => {
                let time = self.text(0).parse().ok().filter(|time: &f64| time.is_finite());
                unit.fraction(time.ok_or(refused)?)
            }
        };
        time_us.ok_or_else(|| self.refused(0, format!("too large for a time in {}", unit.word())))
    }

    /// The time as it stands there.
    pub(super) fn raw_time(&self) -> Option<f64> {
        self.text(0).parse().ok().filter(|time: &f64| time.is_finite())
    }

    fn refused(&self, column: usize, error: impl Display) -> Problem {
        let (column, value) = (self.columns.names[column].to_owned(), self.text(column));
        let value = value.chars().take(60).collect();
        Problem::Value { column, value, problem: error.to_string() }
    }
}

/// A cell without what some writers put around every cell.
fn bare(cell: &str) -> &str {
    let cell = cell.trim();
    cell.strip_prefix('"').and_then(|cell| cell.strip_suffix('"')).unwrap_or(cell).trim()
}
