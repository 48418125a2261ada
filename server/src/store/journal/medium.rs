//! The segment being written, and how it reaches the disk.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use uuid::Uuid;

use super::segment::{self, HEADER};
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

/// The newest segment, its records up to `length` on disk.
pub(super) struct LogSegment {
    pub(super) dir: PathBuf,
    pub(super) journal: Uuid,
    pub(super) first: u64,
    pub(super) length: u64,
    pub(super) medium: Box<dyn Medium>,
}

impl LogSegment {
    /// A new, empty segment: its header and its name are on disk.
    pub(super) fn create(dir: &Path, journal: Uuid, first: u64) -> Result<Self, Error> {
        let path = segment::path(dir, first);
        let mut file = OpenOptions::new()
            .create_new(true)
            .append(true)
            .open(path)
            .map_err(io_error("creating a journal segment"))?;
        let write = |file: &mut File| {
            file.write_all(&segment::header(journal, first))?;
            file.sync_all()?;
            File::open(dir)?.sync_all()
        };
        write(&mut file).map_err(io_error("creating a journal segment"))?;
        Ok(Self { dir: dir.to_owned(), journal, first, length: HEADER as u64, medium: Box::new(file) })
    }

    /// The newest segment of a journal, without what lies behind `length`.
    pub(super) fn reopen(dir: &Path, journal: Uuid, first: u64, length: u64) -> Result<Self, Error> {
        let path = segment::path(dir, first);
        let file = OpenOptions::new().append(true).open(path);
        let mut file = file.map_err(io_error("opening a journal segment"))?;
        // Also brings to disk what an earlier process wrote and did not live to sync.
        file.cut(length).map_err(io_error("cutting a torn write off the journal"))?;
        Ok(Self { dir: dir.to_owned(), journal, first, length, medium: Box::new(file) })
    }
}
