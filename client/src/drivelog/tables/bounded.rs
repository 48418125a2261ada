//! Text that is read no farther than any table goes: a small file may unpack to gigabytes, or to one endless line.

use std::io::{self, Read};

/// Bytes of a line, at most.
const MAX_LINE: usize = 64 << 10;

/// A reader that ends with an error where a line or all of it is too long.
pub(super) struct BoundedText<R> {
    inner: R,
    /// Bytes that may still come.
    left: u64,
    /// Bytes since the last end of a line.
    line: usize,
}

impl<R: Read> BoundedText<R> {
    pub(super) fn new(inner: R, most: u64) -> Self {
        Self { inner, left: most, line: 0 }
    }
}

impl<R: Read> Read for BoundedText<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(bytes)?;
        let refused = |why: &str| io::Error::new(io::ErrorKind::InvalidData, why.to_owned());
        let left = self.left.checked_sub(read as u64);
        self.left = left.ok_or_else(|| refused("the file unpacks to far more than any drive log does"))?;
        // A read is no longer than a line may be by much: the lines within it need no look.
        self.line = match bytes[..read].iter().rposition(|byte| *byte == b'\n') {
            Some(end) => read - end,
            None => self.line + read,
        };
        if self.line > MAX_LINE {
            return Err(refused("a line is longer than 65536 bytes"));
        }
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8], most: u64) -> io::Result<usize> {
        io::copy(&mut BoundedText::new(text, most), &mut io::sink()).map(|bytes| bytes as usize)
    }

    #[test]
    fn endless_lines_and_texts_are_refused() {
        let lines = "time_us,sensor\n".repeat(100_000);
        assert_eq!(read(lines.as_bytes(), 1 << 30).unwrap(), lines.len());
        assert!(read(lines.as_bytes(), 1000).unwrap_err().to_string().contains("unpacks"));
        assert!(read(&vec![b'0'; 1 << 20], 1 << 30).unwrap_err().to_string().contains("line"));
    }
}
