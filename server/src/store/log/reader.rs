//! Reading the records of a journal again.

use super::position::RecordPosition;
use super::segment;
use crate::store::api::{Error, io_error};
use crate::store::backend::objects::Readable;
use crate::store::backend::segments::Segments;

/// Reads records.
pub(in crate::store) struct RecordReader<'a> {
    segments: &'a dyn Segments,
    open: Option<(u64, Box<dyn Readable>)>,
}

impl<'a> RecordReader<'a> {
    pub(in crate::store) fn of(segments: &'a dyn Segments) -> Self {
        Self { segments, open: None }
    }

    /// The payload of a record, checked against its checksum.
    ///
    /// # Errors
    /// When the disk refuses or the record is damaged.
    pub(in crate::store) fn payload(&mut self, at: RecordPosition) -> Result<Vec<u8>, Error> {
        let file = match self.open.take() {
            Some((segment, file)) if segment == at.segment => file,
            _ => self.segments.open(at.segment).map_err(io_error("opening a journal segment"))?,
        };
        let mut bytes = vec![0; segment::RECORD_HEADER + at.length as usize];
        let start = u64::from(at.offset) - segment::RECORD_HEADER as u64;
        file.read_at(start, &mut bytes).map_err(io_error("reading a journal record"))?;
        self.open = Some((at.segment, file));
        if segment::parse_record(&bytes).is_none_or(|record| record.payload.len() != at.length as usize) {
            let reason = "a record does not match its checksum";
            return Err(damaged(self.segments, at.segment, start as usize, reason));
        }
        bytes.drain(..segment::RECORD_HEADER);
        Ok(bytes)
    }
}

/// What is wrong with a segment.
pub(in crate::store) fn damaged(segments: &dyn Segments, first: u64, at: usize, reason: &str) -> Error {
    Error::Damaged {
        what: format!("journal segment {} at byte {at}", segments.locate(first)),
        reason: reason.to_owned(),
    }
}
