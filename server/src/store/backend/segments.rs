//! The files of a journal: each is appended to by one writer, and named by the number of its first record.

use std::io;

use super::objects::Readable;

/// Bytes that each segment begins with.
pub(in crate::store) const HEADER: usize = 32;

/// A segment that is written.
pub(in crate::store) trait Medium: Send {
    /// Appends all bytes. After a failure any part of them may be there.
    ///
    /// # Errors
    /// When the backend refuses.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Returns once all that was appended is durable.
    ///
    /// # Errors
    /// When that is not certain. No later success says anything of what was appended before.
    fn sync(&mut self) -> io::Result<()>;

    /// Cuts it back to a length, durably.
    ///
    /// # Errors
    /// When the backend refuses.
    fn cut(&mut self, length: u64) -> io::Result<()>;
}

/// A segment in a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct Listed {
    /// Number of its first record.
    pub(in crate::store) first: u64,
    /// Its bytes.
    pub(in crate::store) bytes: u64,
}

/// The segments of one journal.
pub(in crate::store) trait Segments: Send + Sync {
    /// All segments, in order. Unlike [`super::objects::Objects::list`] it is never old: the journal rests on it.
    ///
    /// # Errors
    /// When the backend refuses.
    fn list(&self) -> io::Result<Vec<Listed>>;

    /// Opens a segment for reading.
    ///
    /// # Errors
    /// When there is none, or the backend refuses.
    fn open(&self, first: u64) -> io::Result<Box<dyn Readable>>;

    /// A new segment that holds its header, durably.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] when there is one of this number, which stays as it is; or when the backend
    /// refuses.
    fn create(&self, first: u64, header: &[u8; HEADER]) -> io::Result<Box<dyn Medium>>;

    /// A segment that holds its header, durably, in place of the one there is. What is still written to that goes nowhere.
    ///
    /// # Errors
    /// When the backend refuses.
    fn replace(&self, first: u64, header: &[u8; HEADER]) -> io::Result<Box<dyn Medium>>;

    /// Opens a segment that another process began.
    ///
    /// # Errors
    /// When there is none, or the backend refuses.
    fn resume(&self, first: u64) -> io::Result<Box<dyn Medium>>;

    /// Deletes segments, in this order; ones that are not there are no error.
    ///
    /// # Errors
    /// When the backend refuses.
    fn delete(&self, firsts: &[u64]) -> io::Result<()>;

    /// Where whoever runs the store finds a segment.
    fn locate(&self, first: u64) -> String;
}

/// The name of a segment, in a directory and in backups.
pub(in crate::store) fn name(first: u64) -> String {
    format!("{first:020}.seg")
}

/// The number of a segment's first record, by its name.
pub(in crate::store) fn first_of(name: &str) -> Option<u64> {
    let digits = name.strip_suffix(".seg")?;
    let sound = digits.len() == 20 && digits.bytes().all(|byte| byte.is_ascii_digit());
    sound.then(|| digits.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked() {
        assert_eq!(first_of(&name(12)), Some(12));
        for stray in ["12.seg", "0000000000000000012x.seg", "00000000000000000012.tmp", "notes.txt"] {
            assert_eq!(first_of(stray), None, "{stray}");
        }
    }
}
