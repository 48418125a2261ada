//! The files of a spool.
//!
//! A file is the magic `EFXSPL01`, the CRC-32C of the rest (4 bytes, little-endian), its length
//! (8 bytes, little-endian), and the upload's messages, each preceded by its length.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use super::super::DamagedUpload;

const MAGIC: &[u8; 8] = b"EFXSPL01";
const HEADER: usize = 20;
/// Bytes of a file, at most: several times what the service takes of an upload.
const MAX_BYTES: u64 = 64 << 20;

/// A body behind its header, by which damage is noticed.
pub(super) fn seal(body: &[u8]) -> Vec<u8> {
    let mut contents = Vec::with_capacity(HEADER + body.len());
    contents.extend_from_slice(MAGIC);
    contents.extend_from_slice(&crc32c::crc32c(body).to_le_bytes());
    contents.extend_from_slice(&(body.len() as u64).to_le_bytes());
    contents.extend_from_slice(body);
    contents
}

/// All of a file; `None` of one that is larger than any upload.
pub(super) fn read(path: &Path) -> io::Result<Option<Vec<u8>>> {
    let (mut contents, file) = (Vec::new(), File::open(path)?);
    file.take(MAX_BYTES + 1).read_to_end(&mut contents)?;
    Ok((contents.len() as u64 <= MAX_BYTES).then_some(contents))
}

/// The body, if it is whole.
pub(super) fn open(contents: &[u8]) -> Result<&[u8], DamagedUpload> {
    let (header, body) = contents.split_at_checked(HEADER).ok_or(DamagedUpload("the file is too short"))?;
    let (magic, rest) = header.split_at(MAGIC.len());
    let (crc, len) = rest.split_at(4);
    if magic != MAGIC {
        return Err(DamagedUpload("the file does not begin as a spooled upload"));
    }
    if len != (body.len() as u64).to_le_bytes() {
        return Err(DamagedUpload("the file is not as long as it says"));
    }
    if crc != crc32c::crc32c(body).to_le_bytes() {
        return Err(DamagedUpload("the checksum does not match"));
    }
    Ok(body)
}

/// Deletes the oldest files of a folder (by name) beyond a number of bytes.
pub(super) fn trim(dir: &Path, max_bytes: u64) -> io::Result<()> {
    let mut files: Vec<(PathBuf, u64)> = Vec::new();
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        files.push((entry.path(), entry.metadata()?.len()));
    }
    files.sort();
    let mut bytes: u64 = files.iter().map(|(_, bytes)| bytes).sum();
    for (path, size) in files {
        if bytes <= max_bytes {
            break;
        }
        tracing::warn!(file = %path.display(), "deleted to bound what is set aside");
        fs::remove_file(path)?;
        bytes -= size;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_flipped_bit_and_any_cut_is_found(body in proptest::collection::vec(any::<u8>(), 0..200), at in any::<prop::sample::Index>(), bit in 0..8) {
            let good = seal(&body);
            prop_assert_eq!(open(&good), Ok(body.as_slice()));
            let at = at.index(good.len());
            let mut flipped = good.clone();
            flipped[at] ^= 1_u8 << bit;
            prop_assert!(open(&flipped).is_err());
            prop_assert!(open(&good[..at]).is_err());
        }
    }
}
