//! CSV files, gzipped or not, whose errors name the line.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::super::error::{Error, io_error};
use super::super::stamp::TimeUnit;
use super::super::{Flaws, Problem};
use super::bounded::BoundedText;
use super::cells::{Cells, Columns};

/// Times that a table may be larger than its file, and bytes that it may always have: beyond, it is made to fill the memory.
const MOST_PACKED: u64 = 100;
const ALWAYS_UNPACKED: u64 = 64 << 20;

/// Rows of which the times are looked at to tell their unit.
const LOOKED_AT: usize = 100;

/// A table that is there, compressed or not.
pub(crate) struct Table {
    path: PathBuf,
}

impl Table {
    /// The file of this name in a folder, or its `.gz` twin.
    ///
    /// # Errors
    /// When both are there.
    pub(crate) fn find(folder: &Path, name: &str) -> Result<Option<Self>, Error> {
        let plain = folder.join(name);
        let gz = folder.join(format!("{name}.gz"));
        match (plain.is_file(), gz.is_file()) {
            (true, true) => Err(Error::Twice { path: plain }),
            (true, false) => Ok(Some(Self { path: plain })),
            (false, true) => Ok(Some(Self { path: gz })),
            (false, false) => Ok(None),
        }
    }

    /// Gives every row to `take`, which says what is wrong with one it cannot use; the header must
    /// name at least the `required` columns.
    ///
    /// # Errors
    /// Naming the file and the line.
    pub(crate) fn rows<R: DeserializeOwned>(
        &self,
        required: &[&str],
        take: impl FnMut(R) -> Result<(), Problem>,
    ) -> Result<(), Error> {
        self.trimmed(csv::Trim::All, required, take)
    }

    /// [`Table::rows`] whose cells are text, in which spaces mean something.
    ///
    /// # Errors
    /// Naming the file and the line.
    pub(super) fn texts<R: DeserializeOwned>(
        &self,
        required: &[&str],
        take: impl FnMut(R) -> Result<(), Problem>,
    ) -> Result<(), Error> {
        self.trimmed(csv::Trim::Headers, required, take)
    }

    fn trimmed<R: DeserializeOwned>(
        &self,
        trim: csv::Trim,
        required: &[&str],
        mut take: impl FnMut(R) -> Result<(), Problem>,
    ) -> Result<(), Error> {
        let mut reader = csv::ReaderBuilder::new().trim(trim).from_reader(self.open()?);
        let headers = reader.headers().map_err(|e| self.unreadable(&e, 1))?.clone();
        if let Some(missing) = required.iter().find(|column| headers.iter().all(|h| h != **column)) {
            let problem =
                Problem::MissingColumn { column: (*missing).to_owned(), expected: required.join(",") };
            return Err(self.bad_row(1, problem));
        }
        let mut record = csv::StringRecord::new();
        loop {
            let line = reader.position().line();
            match reader.read_record(&mut record) {
                Ok(false) => return Ok(()),
                Ok(true) => {}
                Err(error) => return Err(self.unreadable(&error, line)),
            }
            let row = record.deserialize(Some(&headers));
            let row = row.map_err(|e| self.bad_row(line, unparsable(&e, &headers, &record)))?;
            take(row).map_err(|problem| self.bad_row(line, problem))?;
        }
    }

    /// Gives every row to `take`. Rows that cannot be read, or that `take` cannot use, are counted as flaws; the header must
    /// name the first `required` columns. The first column is the time.
    ///
    /// # Errors
    /// When the file cannot be opened, the header lacks a column, or no row can be used while there are some.
    pub(super) fn records(
        &self,
        names: &'static [&'static str],
        required: usize,
        flaws: &mut Flaws,
        mut take: impl FnMut(&Cells, u64) -> Result<(), Problem>,
    ) -> Result<(), Error> {
        let part = self.name();
        let mut columns = None;
        let (mut kept, mut first) = (0_u64, None);
        let unit = self.time_unit(names, required)?;
        self.each(|record, line| {
            let problem = match (record, &columns) {
                (Ok(header), None) => {
                    let mut found = Columns::find(header, names, required)?;
                    found.unit = unit;
                    columns = Some(found);
                    return Ok(true);
                }
                (Ok(record), Some(columns)) => {
                    let cells = Cells { columns, record };
                    cells.fit().and_then(|()| take(&cells, line)).err()
                }
                (Err(problem), None) => return Err(problem),
                (Err(problem), Some(_)) => Some(problem),
            };
            match problem {
                None => kept += 1,
                Some(problem) => {
                    flaws.skip(&part, line, &problem);
                    first.get_or_insert((line, problem));
                }
            }
            Ok(true)
        })?;
        if let Some((line, problem)) = first.filter(|_| kept == 0) {
            return Err(self.bad_row(line, problem));
        }
        if unit != TimeUnit::Microseconds && kept > 0 {
            flaws.note(format!("{part}: times are in {}, and were read so", unit.word()));
        }
        Ok(())
    }

    /// The unit of the times: as the header states, else as the first rows show.
    fn time_unit(&self, names: &'static [&'static str], required: usize) -> Result<TimeUnit, Error> {
        let mut columns: Option<Columns> = None;
        let mut times = Vec::new();
        self.each(|record, _| {
            match (record, &columns) {
                (Ok(header), None) => columns = Some(Columns::find(header, names, required)?),
                (Ok(record), Some(columns)) => times.extend(Cells { columns, record }.raw_time()),
                (Err(problem), None) => return Err(problem),
                (Err(_), Some(_)) => {}
            }
            Ok(times.len() < LOOKED_AT)
        })?;
        let stated = columns.and_then(|columns| columns.stated);
        Ok(stated.unwrap_or_else(|| TimeUnit::of(&times)))
    }

    /// Gives every record to `take`, the header first, or what is wrong with it, until it says that it has enough.
    fn each(
        &self,
        mut take: impl FnMut(Result<&csv::StringRecord, Problem>, u64) -> Result<bool, Problem>,
    ) -> Result<(), Error> {
        // A quote in a row of numbers is damage: it must not take the rows behind it.
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .quoting(false)
            .flexible(true)
            .from_reader(self.open()?);
        let mut record = csv::StringRecord::new();
        loop {
            let line = reader.position().line();
            let outcome = match reader.read_record(&mut record) {
                Ok(false) => return Ok(()),
                Ok(true) => take(Ok(&record), line),
                Err(error) => match error.kind() {
                    csv::ErrorKind::Io(cause) if self.is_damage(cause) => {
                        let cut = take(Err(Problem::CutOff(cause.to_string())), line);
                        return cut.map(|_| ()).map_err(|problem| self.bad_row(line, problem));
                    }
                    csv::ErrorKind::Io(_) => return Err(self.unreadable(&error, line)),
                    _ => take(Err(problem_of(&error)), line),
                },
            };
            match outcome {
                Ok(true) => {}
                Ok(false) => return Ok(()),
                Err(problem) => return Err(self.bad_row(line, problem)),
            }
        }
    }

    /// Is it the packed file that is damaged, and not the disk?
    fn is_damage(&self, cause: &std::io::Error) -> bool {
        use std::io::ErrorKind::{InvalidData, InvalidInput, UnexpectedEof};
        let packed = self.path.extension().is_some_and(|e| e == "gz");
        packed && [InvalidData, InvalidInput, UnexpectedEof].contains(&cause.kind())
    }

    /// The name of the file.
    pub(super) fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    pub(super) fn path(&self) -> PathBuf {
        self.path.clone()
    }

    fn open(&self) -> Result<Box<dyn Read>, Error> {
        let file = BufReader::new(File::open(&self.path).map_err(|e| io_error(&self.path, e))?);
        let packed = file.get_ref().metadata().map_err(|e| io_error(&self.path, e))?.len();
        let is_gz = self.path.extension().is_some_and(|e| e == "gz");
        let most = if is_gz { packed.saturating_mul(MOST_PACKED).max(ALWAYS_UNPACKED) } else { u64::MAX };
        let bytes: Box<dyn Read> = if is_gz { Box::new(MultiGzDecoder::new(file)) } else { Box::new(file) };
        Ok(Box::new(BoundedText::new(bytes, most)))
    }

    fn bad_row(&self, line: u64, problem: Problem) -> Error {
        Error::Row { path: self.path.clone(), line, problem }
    }

    fn unreadable(&self, error: &csv::Error, line: u64) -> Error {
        let line = error.position().map_or(line, csv::Position::line);
        self.bad_row(line, problem_of(error))
    }
}

fn problem_of(error: &csv::Error) -> Problem {
    match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            Problem::FieldCount { found: *len, expected: *expected_len }
        }
        csv::ErrorKind::Utf8 { .. } => Problem::Unparsable("it is not text".to_owned()),
        _ => Problem::Unparsable(error.to_string()),
    }
}

/// What is wrong with a row of which a value cannot be parsed.
fn unparsable(error: &csv::Error, header: &csv::StringRecord, record: &csv::StringRecord) -> Problem {
    let csv::ErrorKind::Deserialize { err, .. } = error.kind() else { return problem_of(error) };
    let cell = err.field().and_then(|field| {
        let field = field as usize;
        Some((header.get(field)?.to_owned(), record.get(field)?.to_owned()))
    });
    match cell {
        Some((column, value)) => Problem::Value { column, value, problem: err.kind().to_string() },
        None => Problem::Unparsable(err.to_string()),
    }
}

/// Writes a table and removes its twin. `rows` is consumed; the header comes from the row type, or
/// from `header` when there are no rows.
pub(super) fn write<R: Serialize>(
    folder: &Path,
    name: &str,
    header: &[&str],
    rows: impl IntoIterator<Item = R>,
) -> Result<(), Error> {
    let path = folder.join(name);
    let plain = name.strip_suffix(".gz");
    let twin = plain.map_or_else(|| folder.join(format!("{name}.gz")), |plain| folder.join(plain));
    let file = BufWriter::new(File::create(&path).map_err(|e| io_error(&path, e))?);
    let refused = |e: csv::Error| io_error(&path, e.into());
    if plain.is_some() {
        let mut gz = GzEncoder::new(file, Compression::default());
        fill(&mut gz, header, rows).map_err(refused)?;
        gz.finish().and_then(|mut file| file.flush()).map_err(|e| io_error(&path, e))?;
    } else {
        fill(file, header, rows).map_err(refused)?;
    }
    match std::fs::remove_file(&twin) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(io_error(&twin, e)),
        _ => Ok(()),
    }
}

fn fill<R: Serialize>(
    sink: impl Write,
    header: &[&str],
    rows: impl IntoIterator<Item = R>,
) -> Result<(), csv::Error> {
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(sink);
    writer.write_record(header)?;
    for row in rows {
        writer.serialize(row)?;
    }
    Ok(writer.flush()?)
}
