//! CSV files, gzipped or not, whose errors name the line.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::super::Problem;
use super::super::error::{Error, io_error};
use super::bounded::BoundedText;

/// Times that a table may be larger than its file, and bytes that it may always have: beyond, it is made to fill the memory.
const MOST_PACKED: u64 = 100;
const ALWAYS_UNPACKED: u64 = 64 << 20;

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
        mut take: impl FnMut(R) -> Result<(), Problem>,
    ) -> Result<(), Error> {
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::Headers).from_reader(self.open()?);
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
            let row = record.deserialize(Some(&headers)).map_err(|e| self.unreadable(&e, line))?;
            take(row).map_err(|problem| self.bad_row(line, problem))?;
        }
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
        let problem = match error.kind() {
            csv::ErrorKind::Deserialize { err, .. } => Problem::Unparsable(err.to_string()),
            csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
                Problem::FieldCount { found: *len, expected: *expected_len }
            }
            _ => Problem::Unparsable(error.to_string()),
        };
        self.bad_row(line, problem)
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
