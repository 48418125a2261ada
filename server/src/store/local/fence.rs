//! The fence: what a server that lost its data directory to another one notices it by, whatever became of the locks.
//!
//! Whoever opens the directory puts a file of its own in place of the file `writer`, and only then reads the journal. A server
//! looks *after* each sync, and before it acknowledges, whether the file is still its own. So what it acknowledges was on
//! disk before another server began to read.

use std::fs::{self, File};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::files::at;
use super::files::put_file_with;
use crate::store::api::Error;

const NAME: &str = "writer";

/// The mark of one opening of a data directory.
#[derive(Debug, Clone)]
pub(super) struct Fence(Arc<Mark>);

#[derive(Debug)]
struct Mark {
    path: PathBuf,
    /// Kept open, so that no other file gets its number.
    file: File,
}

impl Fence {
    /// Takes a directory over.
    pub(super) fn take(root: &Path) -> Result<Self, Error> {
        let path = root.join(NAME);
        // An empty file is one even where the disk is full.
        let file = put_file_with(root, NAME, 0o600, |_| Ok(()));
        let file = file.map_err(at(&path, "taking the data directory over"))?;
        Ok(Self(Arc::new(Mark { path, file })))
    }
}

impl crate::store::backend::owner::Fence for Fence {
    fn check(&self) -> Result<(), Error> {
        let looking = at(&self.0.path, "looking whether the data directory is still this server's");
        let ours = self.0.file.metadata().map_err(&looking)?;
        let same = match fs::metadata(&self.0.path) {
            Ok(there) => (there.dev(), there.ino()) == (ours.dev(), ours.ino()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => false,
            Err(error) => return Err(looking(error)),
        };
        let lost = || Error::Stopped(format!("{} is not this server's any more", self.0.path.display()));
        same.then_some(()).ok_or_else(lost)
    }
}
