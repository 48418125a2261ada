//! Room that is kept for a start on a full disk: sled writes a little when it is opened, and a map that is sound must not stay
//! closed for that.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use super::room;

const NAME: &str = "ballast";
/// More than sled writes to open.
const BYTES: usize = 4 << 20;

/// Takes the room, where there is plenty.
pub(super) fn keep(root: &Path) {
    let path = root.join(NAME);
    if path.exists() || room::for_tiles(root, 4 * BYTES as u64).is_err() {
        return;
    }
    let write = || {
        let mut file = File::create_new(&path)?;
        file.write_all(&vec![0; BYTES])?;
        file.sync_all()
    };
    if let Err(error) = write() {
        tracing::debug!(%error, "no room is kept for a start on a full disk");
    }
}

/// Is there less room than it takes itself?
pub(super) fn is_needed(root: &Path) -> bool {
    room::free(root).is_ok_and(|free| free < BYTES as u64)
}

/// Gives it back; false where none was kept.
pub(super) fn release(root: &Path) -> bool {
    match fs::remove_file(root.join(NAME)) {
        Ok(()) => true,
        Err(error) => {
            if error.kind() != io::ErrorKind::NotFound {
                tracing::warn!(%error, "the room for a start on a full disk cannot be given back");
            }
            false
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_kept_once_and_given_back_once() {
        let dir = tempfile::tempdir().unwrap();
        keep(dir.path());
        keep(dir.path());
        assert_eq!(fs::metadata(dir.path().join(NAME)).unwrap().len(), BYTES as u64);
        assert!(release(dir.path()) && !release(dir.path()));
    }
}
