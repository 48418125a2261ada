//! The directory of a table, removed once it was retired and nobody has it any more.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Attempts to remove a directory that sled's threads are just leaving.
const REMOVALS: usize = 100;

pub(super) struct TableDir {
    path: PathBuf,
    retired: AtomicBool,
}

impl TableDir {
    pub(in crate::store) fn of(path: &Path) -> Self {
        Self { path: path.to_owned(), retired: AtomicBool::new(false) }
    }

    pub(in crate::store) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn parent(&self) -> Option<&Path> {
        self.path.parent()
    }

    /// Removes it once this is dropped.
    pub(in crate::store) fn retire(&self) {
        self.retired.store(true, Ordering::Release);
    }
}

impl Drop for TableDir {
    fn drop(&mut self) {
        if !self.retired.load(Ordering::Acquire) {
            return;
        }
        // An instance of sled that failed keeps its file open: its room is given back all the same.
        if let Ok(file) = fs::OpenOptions::new().write(true).open(self.path.join("db")) {
            let _ = file.set_len(0);
        }
        for _ in 0..REMOVALS {
            match fs::remove_dir_all(&self.path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    std::thread::sleep(Duration::from_millis(10));
                }
                _ => return,
            }
        }
        tracing::warn!(path = %self.path.display(), "old tiles could not be removed; the next start does");
    }
}
