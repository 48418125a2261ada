//! The frame around all encoded values: their format, its version, and a checksum.

/// Bytes before the body.
const HEADER: usize = 8;

/// Why bytes cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Too short, or they do not start as they should.
    #[error("these bytes are not of this format")]
    NotOurs,
    /// Of this format, but written by an older or newer version of the software.
    #[error("these bytes have format version {found}, but this software reads version {known} only: {}",
        advice(*.found, *.known))]
    Version {
        /// The format version of the bytes.
        found: u8,
        /// The format version that this software reads.
        known: u8,
    },
    /// The checksum does not match.
    #[error("the checksum does not match: the bytes are damaged")]
    Checksum,
    /// The content does not follow the format.
    #[error("the content does not follow the format")]
    Malformed,
    /// It holds more tiles than it may, as its header says.
    #[error("it holds {found} tiles, and at most {most} are taken; split it")]
    TooManyTiles {
        /// As many as it holds.
        found: usize,
        /// As many as are taken.
        most: usize,
    },
    /// It holds more cells than it may, as its header says.
    #[error("it holds {found} cells, and at most {most} are taken; split it")]
    TooManyCells {
        /// As many as it holds.
        found: usize,
        /// As many as are taken.
        most: usize,
    },
}

fn advice(found: u8, known: u8) -> &'static str {
    if found < known { "make them again from their source" } else { "update it" }
}

/// A format: how its bytes begin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SealedFormat {
    pub(crate) magic: [u8; 3],
    pub(crate) version: u8,
}

impl SealedFormat {
    /// `magic | version (1 byte) | CRC-32C of the body (4 bytes, LE) | body`
    pub(crate) fn seal(self, body: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(HEADER + body.len());
        out.extend_from_slice(&self.magic);
        out.push(self.version);
        out.extend_from_slice(&crc32c::crc32c(body).to_le_bytes());
        out.extend_from_slice(body);
        out
    }

    /// The body of bytes of this format and version, undamaged.
    pub(crate) fn unseal(self, bytes: &[u8]) -> Result<&[u8], DecodeError> {
        let ([a, b, c, version, sum @ ..], body) =
            bytes.split_first_chunk::<HEADER>().ok_or(DecodeError::NotOurs)?;
        if [*a, *b, *c] != self.magic {
            return Err(DecodeError::NotOurs);
        }
        if *version != self.version {
            return Err(DecodeError::Version { found: *version, known: self.version });
        }
        if crc32c::crc32c(body) != u32::from_le_bytes(*sum) {
            return Err(DecodeError::Checksum);
        }
        Ok(body)
    }
}

/// A zstd frame.
pub(crate) fn compressed(bytes: &[u8], level: i32) -> Vec<u8> {
    zstd::bulk::compress(bytes, level)
        .expect("compressing into a buffer of the library's own bound cannot fail")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_kinds_versions_and_damage_are_told_apart() {
        let format = SealedFormat { magic: *b"EFT", version: 2 };
        let sealed = format.seal(b"body");
        assert_eq!(format.unseal(&sealed), Ok(&b"body"[..]));
        assert_eq!(SealedFormat { magic: *b"EFL", version: 2 }.unseal(&sealed), Err(DecodeError::NotOurs));
        assert_eq!(format.unseal(&sealed[..7]), Err(DecodeError::NotOurs));
        assert_eq!(format.unseal(&sealed[..11]), Err(DecodeError::Checksum));
        let old = SealedFormat { version: 1, ..format }.seal(b"body");
        let error = format.unseal(&old).unwrap_err();
        assert_eq!(error, DecodeError::Version { found: 1, known: 2 });
        assert!(error.to_string().contains("make them again"), "{error}");
    }
}
