//! One server at a time. A file can be unlinked while it is locked, and made and locked again: then two servers would
//! write. So the directories themselves are locked, which nobody takes away unnoticed, and their lock is not a file.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;

use super::files::at;
use crate::store::api::Error;

/// What is locked for as long as it is held open.
pub(super) struct Locks(Vec<File>);

impl Locks {
    /// Locks a data directory. The file is for servers of before the directory itself was locked.
    pub(super) fn of(root: &Path) -> Result<Self, Error> {
        let mut locks = Self(Vec::new());
        locks.hold(root)?;
        let path = root.join("lock");
        let file = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
        let file = file.map_err(at(&path, "creating the lock file"))?;
        match file.try_lock() {
            Ok(()) => locks.0.push(file),
            Err(TryLockError::WouldBlock) => return Err(Error::InUse(root.display().to_string())),
            Err(TryLockError::Error(error)) => return Err(at(&path, "locking the data directory")(error)),
        }
        Ok(locks)
    }

    /// Locks a directory, too. Some network file systems lock no directories; there the lock file and the fence remain.
    pub(super) fn hold(&mut self, dir: &Path) -> Result<(), Error> {
        let file = File::open(dir).map_err(at(dir, "opening a directory to lock it"))?;
        match file.try_lock() {
            Ok(()) => self.0.push(file),
            Err(TryLockError::WouldBlock) => return Err(Error::InUse(dir.display().to_string())),
            Err(TryLockError::Error(error)) => {
                tracing::debug!(%error, dir = %dir.display(), "this file system does not lock directories");
            }
        }
        Ok(())
    }
}
