//! Files that appear whole or not at all, and folders that one process uses.

use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::Path;

/// Ending of files that are being written; what a crash leaves under it was never there.
pub(crate) const PART: &str = "part";

/// Writes a file that appears whole or not at all, and stays.
pub(crate) fn write_durably(dir: &Path, path: &Path, contents: &[u8]) -> io::Result<()> {
    let part = path.with_extension(PART);
    let written = write_synced(&part, contents).and_then(|()| fs::rename(&part, path));
    if let Err(error) = written {
        // What is left is removed at the next opening if not now.
        let _ = fs::remove_file(&part);
        return Err(error);
    }
    File::open(dir)?.sync_all()
}

fn write_synced(path: &Path, contents: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(contents)?;
    file.sync_all()
}

/// Takes a folder's lock file, which holds as long as the file is open; `None` when another has it.
pub(crate) fn lock(path: &Path) -> io::Result<Option<File>> {
    let file = File::create(path)?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(error)) => Err(error),
    }
}
