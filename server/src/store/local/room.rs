//! How much room a disk has left.

use std::path::Path;

use crate::store::api::{Error, io_error};

const MIB: u64 = 1 << 20;

/// What sled may write beyond what it is given: segments that it fills, and old ones that it moves.
const HEADROOM: u64 = 8 * MIB;
/// Bytes that sled may take for each byte it is given.
const TIMES: u64 = 4;

/// Is there room to write so many bytes of tiles? Asked before sled is: once it fails to write it writes no more.
///
/// # Errors
/// When there is not, or that cannot be told.
pub(super) fn for_tiles(dir: &Path, bytes: u64) -> Result<(), Error> {
    let free = free(dir)?;
    let needed = HEADROOM.saturating_add(bytes.saturating_mul(TIMES));
    if free >= needed {
        return Ok(());
    }
    let dir = dir.display().to_string();
    Err(Error::NoRoom { dir, free_mib: free / MIB, needed_mib: needed.div_ceil(MIB) })
}

/// Bytes that may still be written where a directory lies.
///
/// # Errors
/// When the system does not tell.
pub fn free(dir: &Path) -> Result<u64, Error> {
    let stat = rustix::fs::statvfs(dir)
        .map_err(|error| io_error("asking for the room on the disk")(error.into()))?;
    Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_asked_for_with_some_to_spare() {
        let dir = tempfile::tempdir().unwrap();
        assert!(for_tiles(dir.path(), 1).is_ok());
        match for_tiles(dir.path(), u64::MAX) {
            Err(Error::NoRoom { free_mib, needed_mib, .. }) => assert!(free_mib > 8 && needed_mib > free_mib),
            other => panic!("{other:?}"),
        }
        assert!(for_tiles(&dir.path().join("nowhere"), 1).is_err());
    }
}
