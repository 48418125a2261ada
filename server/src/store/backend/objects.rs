//! Immutable objects under names.

use std::io::{self, BufReader, Read, Write};

/// Something that was opened for reading. What it held then can be read for as long as it is held, whatever becomes of
/// its name.
pub(in crate::store) trait Readable: Send + Sync {
    /// Its bytes.
    ///
    /// # Errors
    /// When the backend refuses.
    fn length(&self) -> io::Result<u64>;

    /// Fills `out` from a byte on.
    ///
    /// # Errors
    /// [`io::ErrorKind::UnexpectedEof`] when there is less; or when the backend refuses.
    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()>;
}

/// Whole objects: each is written once, and read, listed and deleted by its name.
pub(in crate::store) trait Objects: Send + Sync {
    /// Puts a new object. It is whole and durable when this returns. After a failure it is there, whole, or it is not.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] when something has the name, which stays as it is; when `write` fails, or the
    /// backend refuses.
    fn put_new(&self, name: &str, write: &mut dyn FnMut(&mut dyn Write) -> io::Result<()>) -> io::Result<()>;

    /// Opens an object.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] when there is none; or when the backend refuses.
    fn open(&self, name: &str) -> io::Result<Box<dyn Readable>>;

    /// The names that begin with a prefix, in order. A list may be old: what it names may be gone, and what was just put
    /// may be missing.
    ///
    /// # Errors
    /// When the backend refuses.
    fn list(&self, prefix: &str) -> io::Result<Vec<String>>;

    /// Deletes an object; one that is not there is no error.
    ///
    /// # Errors
    /// When the backend refuses.
    fn delete(&self, name: &str) -> io::Result<()>;

    /// Where whoever runs the store finds an object.
    fn locate(&self, name: &str) -> String;
}

/// What was opened, read from its beginning.
pub(in crate::store) fn reader(object: Box<dyn Readable>) -> io::Result<impl Read> {
    let length = object.length()?;
    Ok(BufReader::with_capacity(READ_AT_ONCE, FromStart { object, at: 0, length }))
}

/// Bytes that are asked for at once.
const READ_AT_ONCE: usize = 64 << 10;

struct FromStart {
    object: Box<dyn Readable>,
    at: u64,
    length: u64,
}

impl Read for FromStart {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let left = usize::try_from(self.length - self.at).unwrap_or(usize::MAX);
        let count = out.len().min(left);
        self.object.read_at(self.at, &mut out[..count])?;
        self.at += count as u64;
        Ok(count)
    }
}
