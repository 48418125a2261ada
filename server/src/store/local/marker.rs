//! The marker in a directory of tiles: who made it, and from which journal.
//!
//! ```text
//! magic "EFT" 1 (4) | CRC-32C of the rest (4) | journal id (16)
//! ```

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use uuid::Uuid;

use super::files::put_file;
use crate::store::checksum::{seal, sealed};

/// How the names of generations of tiles begin.
pub(super) const TILES: &str = "tiles-";

const MAGIC: [u8; 4] = *b"EFT\x01";
const NAME: &str = "made-from";
const LENGTH: usize = 24;

/// Marks a directory of tiles as this store's.
pub(super) fn mark(dir: &Path, journal: Uuid) -> io::Result<()> {
    let mut bytes = [0; LENGTH];
    bytes[..4].copy_from_slice(&MAGIC);
    bytes[8..].copy_from_slice(journal.as_bytes());
    seal(&mut bytes[4..], &[]);
    put_file(dir, NAME, |file| file.write_all(&bytes))
}

/// Removes a directory of tiles, its marker last: what a crash leaves of it is known to be this store's still.
pub(in crate::store) fn remove(dir: &Path) -> io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let path = entry?.path();
        if path.is_dir() {
            fs::remove_dir_all(path)?;
        } else if !path.ends_with(NAME) {
            fs::remove_file(path)?;
        }
    }
    fs::remove_dir_all(dir)
}

/// The journal that the tiles of a directory were made from; `None` where nothing sound says so.
pub(super) fn marked(dir: &Path) -> Option<Uuid> {
    let bytes: [u8; LENGTH] = fs::read(dir.join(NAME)).ok()?.try_into().ok()?;
    let journal = sealed(&bytes[4..], &[])?;
    (bytes[..4] == MAGIC).then(|| Uuid::from_slice(journal).ok())?
}
