//! The segment being written, and how it reaches the disk.

use std::io;

use uuid::Uuid;

use super::segment;
use crate::store::api::{Error, io_error};
use crate::store::backend::segments::{HEADER, Medium, Segments};

/// The segment that is written, its records up to `length` on disk.
pub(super) struct LogSegment {
    pub(in crate::store) first: u64,
    pub(in crate::store) length: u64,
    pub(super) medium: Box<dyn Medium>,
}

impl LogSegment {
    /// A new, empty segment: its header and its name are on disk. A file of its name was put there by a server that had
    /// lost the directory, else it would have been found when the journal was read: nobody was told of what it holds. That
    /// the directory is this server's is asked after the file was seen: see [`crate::store::backend::owner::Fence`].
    pub(in crate::store) fn create(
        segments: &dyn Segments,
        journal: Uuid,
        first: u64,
        still_ours: impl FnOnce() -> Result<(), Error>,
    ) -> Result<Self, Error> {
        let header = segment::header(journal, first);
        let medium = match segments.create(first, &header) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                still_ours()?;
                segments.delete(&[first]).and_then(|()| segments.create(first, &header))
            }
            outcome => outcome,
        };
        Self::empty(first, medium)
    }

    /// A segment without a record in place of the one there is: what a server that lost the directory still writes to that
    /// goes nowhere.
    pub(in crate::store) fn replace(
        segments: &dyn Segments,
        journal: Uuid,
        first: u64,
    ) -> Result<Self, Error> {
        Self::empty(first, segments.replace(first, &segment::header(journal, first)))
    }

    fn empty(first: u64, medium: io::Result<Box<dyn Medium>>) -> Result<Self, Error> {
        let medium = medium.map_err(io_error("creating a journal segment"))?;
        Ok(Self { first, length: HEADER as u64, medium })
    }

    /// Has nobody been told of a record in it?
    pub(in crate::store) fn is_empty(&self) -> bool {
        self.length == HEADER as u64
    }
}

/// Cuts a torn write off a segment, and makes durable what an earlier process wrote and did not live to sync.
pub(super) fn settle(segments: &dyn Segments, first: u64, length: u64) -> Result<(), Error> {
    let mut segment = segments.resume(first).map_err(io_error("opening a journal segment"))?;
    segment.cut(length).map_err(io_error("cutting a torn write off the journal"))
}
