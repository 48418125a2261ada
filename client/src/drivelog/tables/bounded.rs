//! Text that is read no farther than any table goes: a small file may unpack to gigabytes, or to one endless line.

use std::io::{self, Read};

/// Bytes of a line, at most. What a line has more is left out: it is damage, and what comes behind it may be good.
const MAX_LINE: usize = 64 << 10;

/// A reader that ends with an error where all of it is too long, and shortens lines that are.
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

    /// Moves together what is kept of some bytes; returns how many those are.
    fn shorten(&mut self, bytes: &mut [u8]) -> usize {
        let mut kept = 0;
        for at in 0..bytes.len() {
            let byte = bytes[at];
            self.line = if byte == b'\n' { 0 } else { self.line.saturating_add(1) };
            if self.line <= MAX_LINE {
                bytes[kept] = byte;
                kept += 1;
            }
        }
        kept
    }
}

impl<R: Read> Read for BoundedText<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            let read = self.inner.read(bytes)?;
            let Some(left) = self.left.checked_sub(read as u64) else {
                let why = "the file unpacks to far more than any drive log does";
                return Err(io::Error::new(io::ErrorKind::FileTooLarge, why));
            };
            self.left = left;
            let kept = self.shorten(&mut bytes[..read]);
            // Nothing kept is not the end, unless nothing was read.
            if kept > 0 || read == 0 {
                return Ok(kept);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8], most: u64) -> io::Result<Vec<u8>> {
        let mut all = Vec::new();
        BoundedText::new(text, most).read_to_end(&mut all)?;
        Ok(all)
    }

    #[test]
    fn endless_texts_are_refused_and_endless_lines_shortened() {
        let lines = "time_us,sensor\n".repeat(100_000);
        assert_eq!(read(lines.as_bytes(), 1 << 30).unwrap(), lines.as_bytes());
        assert!(read(lines.as_bytes(), 1000).unwrap_err().to_string().contains("unpacks"));
        let torn = [&b"1,2\n"[..], &vec![0; 1 << 20], &b"\n3,4\n"[..]].concat();
        let kept = read(&torn, 1 << 30).unwrap();
        assert!(kept.len() < 70_000 && kept.ends_with(b"\n3,4\n"), "{}", kept.len());
    }
}
