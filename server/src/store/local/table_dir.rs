//! The directory of a table, removed once it was retired and nobody has it any more.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use uuid::Uuid;

use super::marker::{self, mark, marked};
use crate::store::api::{Error, io_error};

/// Attempts to remove a directory that sled's threads are just leaving.
const REMOVALS: usize = 100;

pub(super) struct TableDir {
    path: PathBuf,
    /// It was just made.
    new: bool,
    retired: AtomicBool,
}

impl TableDir {
    /// A directory that is there.
    pub(super) fn of(path: &Path) -> Self {
        Self { path: path.to_owned(), new: false, retired: AtomicBool::new(false) }
    }

    /// A new directory, marked as made from a journal; nothing may be in its place.
    pub(super) fn create(path: &Path, journal: Uuid) -> Result<Self, Error> {
        let made = fs::create_dir(path).and_then(|()| mark(path, journal));
        made.map_err(io_error("making a directory for tiles"))?;
        Ok(Self { path: path.to_owned(), new: true, retired: AtomicBool::new(false) })
    }

    /// Its table could not be opened: a new directory goes again.
    pub(super) fn forget_new(&self) {
        if self.new {
            self.retire();
        }
    }

    /// Marks a directory of before there were markers.
    pub(super) fn adopt(&self, journal: Uuid) -> Result<(), Error> {
        match marked(&self.path) {
            Some(_) => Ok(()),
            None => mark(&self.path, journal).map_err(io_error("marking tiles")),
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn parent(&self) -> Option<&Path> {
        self.path.parent()
    }

    /// Removes it once this is dropped.
    pub(super) fn retire(&self) {
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
            match marker::remove(&self.path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    std::thread::sleep(Duration::from_millis(10));
                }
                _ => return,
            }
        }
        tracing::warn!(path = %self.path.display(), "old tiles could not be removed; the next start does");
    }
}
