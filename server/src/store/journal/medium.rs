//! The segment being written, and how it reaches the disk.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use uuid::Uuid;

use super::segment::{self, HEADER};
use crate::store::data_dir::replaced;
use crate::store::{Error, io_error};

/// An append-only file. A trait so that tests can make the disk fail.
pub(super) trait Medium: Send {
    /// Appends all bytes.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;
    /// Returns once all that was appended is on disk.
    fn sync(&mut self) -> io::Result<()>;
    /// Cuts the file back to a length, on disk.
    fn cut(&mut self, length: u64) -> io::Result<()>;
}

impl Medium for File {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.sync_all()
    }
}

/// The segment that is written, its records up to `length` on disk.
pub(super) struct LogSegment {
    pub(super) first: u64,
    pub(super) length: u64,
    pub(super) medium: Box<dyn Medium>,
}

impl LogSegment {
    /// A new, empty segment: its header and its name are on disk. One of the same name holds no record that anybody was
    /// told of; what a server that lost the directory still writes to it goes nowhere.
    pub(super) fn create(dir: &Path, journal: Uuid, first: u64) -> Result<Self, Error> {
        let path = segment::path(dir, first);
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let file = replaced(dir, &name, &segment::header(journal, first));
        let file = file.map_err(io_error("creating a journal segment"))?;
        Ok(Self { first, length: HEADER as u64, medium: Box::new(file) })
    }
}

/// Cuts a torn write off a segment, and brings to disk what an earlier process wrote and did not live to sync.
pub(super) fn settle(dir: &Path, first: u64, length: u64) -> Result<(), Error> {
    let file = OpenOptions::new().append(true).open(segment::path(dir, first));
    let mut file = file.map_err(io_error("opening a journal segment"))?;
    file.cut(length).map_err(io_error("cutting a torn write off the journal"))
}
