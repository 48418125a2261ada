//! The segment being written, and how it reaches the disk.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use uuid::Uuid;

use super::segment::{self, HEADER};
use crate::store::api::{Error, io_error};
use crate::store::local::files::{put_new, replaced};

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
    pub(in crate::store) first: u64,
    pub(in crate::store) length: u64,
    pub(super) medium: Box<dyn Medium>,
}

impl LogSegment {
    /// A new, empty segment: its header and its name are on disk. A file of its name was put there by a server that had
    /// lost the directory, else it would have been found when the journal was read: nobody was told of what it holds. That
    /// the directory is this server's is asked after the file was seen: see [`crate::store::local::fence::Fence`].
    pub(in crate::store) fn create(
        dir: &Path,
        journal: Uuid,
        first: u64,
        still_ours: impl FnOnce() -> Result<(), Error>,
    ) -> Result<Self, Error> {
        let (name, header) = (name_of(dir, first), segment::header(journal, first));
        let file = match put_new(dir, &name, &header) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                still_ours()?;
                std::fs::remove_file(dir.join(&name)).and_then(|()| put_new(dir, &name, &header))
            }
            outcome => outcome,
        };
        Self::empty(first, file)
    }

    /// A segment without a record in place of the one there is: what a server that lost the directory still writes to that
    /// goes nowhere.
    pub(in crate::store) fn replace(dir: &Path, journal: Uuid, first: u64) -> Result<Self, Error> {
        Self::empty(first, replaced(dir, &name_of(dir, first), &segment::header(journal, first)))
    }

    fn empty(first: u64, file: io::Result<File>) -> Result<Self, Error> {
        let file = file.map_err(io_error("creating a journal segment"))?;
        Ok(Self { first, length: HEADER as u64, medium: Box::new(file) })
    }

    /// Has nobody been told of a record in it?
    pub(in crate::store) fn is_empty(&self) -> bool {
        self.length == HEADER as u64
    }
}

fn name_of(dir: &Path, first: u64) -> String {
    let path = segment::path(dir, first);
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Cuts a torn write off a segment, and brings to disk what an earlier process wrote and did not live to sync.
pub(super) fn settle(dir: &Path, first: u64, length: u64) -> Result<(), Error> {
    let file = OpenOptions::new().append(true).open(segment::path(dir, first));
    let mut file = file.map_err(io_error("opening a journal segment"))?;
    file.cut(length).map_err(io_error("cutting a torn write off the journal"))
}
