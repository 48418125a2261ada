//! Uploads on disk until the service has them.
//!
//! A spool is a folder: one file an upload, named by its id, so that the order of names is the order
//! of the drive. A file appears whole or not at all (written aside, fsynced, renamed, the folder
//! fsynced). What an accepted upload may meet is the service, and nothing else:
//!
//! - **full**: the spool refuses the *newest* upload with [`Error::Full`]. What was accepted is never
//!   dropped to make room: the caller, who still has the data, can decide, a folder of half-dropped
//!   drives could not; and what was recorded first has waited longest to be acknowledged.
//! - **refused**: an upload the service will never take moves to `refused/`, beside a text with
//!   the reason.
//! - **damaged**: a file that fails its checksum moves to `damaged/`; the queue goes on.
//!
//! The last two are for people to look at; they have a bound of their own, beyond which the oldest
//! are deleted and a warning is logged.

mod file;

use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use uuid::Uuid;

use super::PreparedUpload;
use crate::disk;

const ENDING: &str = "upload";

/// How much a spool may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpoolLimits {
    /// Bytes of waiting uploads.
    pub max_bytes: u64,
    /// Bytes of refused and of damaged uploads, each.
    pub max_set_aside_bytes: u64,
}

impl Default for SpoolLimits {
    /// A gigabyte waiting (some days of driving), 64 MiB each set aside.
    fn default() -> Self {
        Self { max_bytes: 1 << 30, max_set_aside_bytes: 64 << 20 }
    }
}

/// Why the spool cannot do as asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The spool holds as much as it may; the upload was not taken.
    #[error(
        "the spool {} is full: {bytes} of {max_bytes} bytes wait to be sent; keep the upload and try \
         again, or raise the limit", .dir.display()
    )]
    Full {
        /// The spool's folder.
        dir: PathBuf,
        /// Bytes waiting.
        bytes: u64,
        /// Bytes that may wait, at most.
        max_bytes: u64,
    },
    /// Another process sends from this spool.
    #[error("the spool {} is in use by another process; give each its own folder", .dir.display())]
    InUse {
        /// The spool's folder.
        dir: PathBuf,
    },
    /// The file system refuses.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file or folder of the spool.
        path: PathBuf,
        /// The error of the file system.
        source: io::Error,
    },
}

/// A folder of uploads; all methods block on the disk.
#[derive(Debug)]
pub struct Spool {
    dir: PathBuf,
    limits: SpoolLimits,
    state: Mutex<SpoolState>,
    /// Held while a file comes or goes: an upload may be pushed again while the one of before is sent.
    files: Mutex<()>,
    /// Held as long as the spool is open.
    _lock: File,
}

#[derive(Debug, Default)]
struct SpoolState {
    /// Waiting uploads and their sizes in bytes.
    waiting: BTreeMap<Uuid, u64>,
    /// Sizes of waiting uploads and of those being written.
    bytes: u64,
}

impl Spool {
    /// Opens a spool, or makes one; uploads of earlier runs are waiting in it.
    ///
    /// # Errors
    /// When another process has it open or the file system refuses.
    pub fn open(dir: impl Into<PathBuf>, limits: SpoolLimits) -> Result<Self, Error> {
        let dir = dir.into();
        for folder in [dir.clone(), dir.join("refused"), dir.join("damaged")] {
            fs::create_dir_all(&folder).map_err(|e| io_error(&folder, e))?;
        }
        let lock = lock(&dir)?;
        let mut state = SpoolState::default();
        for entry in fs::read_dir(&dir).map_err(|e| io_error(&dir, e))? {
            let path = entry.map_err(|e| io_error(&dir, e))?.path();
            match (id_of(&path), path.extension().and_then(|e| e.to_str())) {
                (Some(id), Some(ENDING)) => {
                    let bytes = fs::metadata(&path).map_err(|e| io_error(&path, e))?.len();
                    state.waiting.insert(id, bytes);
                    state.bytes += bytes;
                }
                // Never accepted: a crash came before the rename.
                (_, Some(disk::PART)) => fs::remove_file(&path).map_err(|e| io_error(&path, e))?,
                _ => {}
            }
        }
        Ok(Self { dir, limits, state: Mutex::new(state), files: Mutex::default(), _lock: lock })
    }

    /// Takes an upload; once this returns, the upload survives a power cut.
    ///
    /// # Errors
    /// When the spool is full or the file system refuses; the upload is not taken then.
    pub fn push(&self, upload: &PreparedUpload) -> Result<(), Error> {
        let contents = file::seal(&upload.encode());
        let bytes = contents.len() as u64;
        self.reserve(upload.id(), bytes)?;
        let path = self.path_of(upload.id());
        let _files = self.files();
        let written = disk::write_durably(&self.dir, &path, &contents);
        let mut state = self.state();
        match written {
            Ok(()) => {
                if let Some(before) = state.waiting.insert(upload.id(), bytes) {
                    state.bytes -= before;
                }
                Ok(())
            }
            Err(source) => {
                state.bytes -= bytes;
                Err(io_error(&path, source))
            }
        }
    }

    /// The oldest waiting upload that is not among `skip`.
    #[must_use]
    pub fn oldest(&self, skip: &HashSet<Uuid>) -> Option<Uuid> {
        self.state().waiting.keys().find(|id| !skip.contains(id)).copied()
    }

    /// Reads a waiting upload; `None` when its file was damaged and has been set aside.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn read(&self, id: Uuid) -> Result<Option<PreparedUpload>, Error> {
        let path = self.path_of(id);
        let _files = self.files();
        let contents = match file::read(&path) {
            Ok(Some(contents)) => contents,
            Ok(None) => {
                return self.set_aside(id, "damaged", "the file is larger than any upload").map(|()| None);
            }
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                tracing::warn!(%id, "a waiting upload has vanished from the spool");
                self.forget(id);
                return Ok(None);
            }
            Err(e) => return Err(io_error(&path, e)),
        };
        let upload = file::open(&contents).and_then(PreparedUpload::decode);
        match upload {
            Ok(upload) if upload.id() == id => Ok(Some(upload)),
            Ok(_) => self.set_aside(id, "damaged", "the file's name is not its upload's id").map(|()| None),
            Err(damage) => self.set_aside(id, "damaged", &damage.to_string()).map(|()| None),
        }
    }

    /// Deletes an upload that the service has.
    ///
    /// The deletion is not fsynced: a file that comes back after a power cut is sent once more and
    /// counts once all the same.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn remove(&self, id: Uuid) -> Result<(), Error> {
        let path = self.path_of(id);
        let _files = self.files();
        self.forget(id);
        fs::remove_file(&path).map_err(|e| io_error(&path, e))
    }

    /// Moves an upload that the service will never take to `refused/`, with the reason.
    ///
    /// # Errors
    /// When the file system refuses.
    pub fn refuse(&self, id: Uuid, reason: &str) -> Result<(), Error> {
        let _files = self.files();
        self.set_aside(id, "refused", reason)
    }

    /// Uploads waiting.
    #[must_use]
    pub fn len(&self) -> usize {
        self.state().waiting.len()
    }

    /// True when nothing waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes of waiting uploads.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.state().bytes
    }

    fn reserve(&self, id: Uuid, bytes: u64) -> Result<(), Error> {
        let mut state = self.state();
        let max_bytes = self.limits.max_bytes;
        if state.bytes + bytes > max_bytes && !state.waiting.contains_key(&id) {
            return Err(Error::Full { dir: self.dir.clone(), bytes: state.bytes, max_bytes });
        }
        state.bytes += bytes;
        Ok(())
    }

    /// Its caller holds [`Spool::files`].
    fn set_aside(&self, id: Uuid, folder: &str, reason: &str) -> Result<(), Error> {
        self.forget(id);
        tracing::warn!(%id, folder, reason, "an upload is set aside");
        let dir = self.dir.join(folder);
        let to = dir.join(format!("{id}.{ENDING}"));
        fs::rename(self.path_of(id), &to).map_err(|e| io_error(&to, e))?;
        let text = to.with_extension("txt");
        fs::write(&text, reason).map_err(|e| io_error(&text, e))?;
        file::trim(&dir, self.limits.max_set_aside_bytes).map_err(|e| io_error(&dir, e))
    }

    fn forget(&self, id: Uuid) {
        let mut state = self.state();
        if let Some(bytes) = state.waiting.remove(&id) {
            state.bytes -= bytes;
        }
    }

    fn path_of(&self, id: Uuid) -> PathBuf {
        self.dir.join(format!("{id}.{ENDING}"))
    }

    fn files(&self) -> MutexGuard<'_, ()> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn state(&self) -> MutexGuard<'_, SpoolState> {
        // Counters stay right even if a holder panicked.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn lock(dir: &Path) -> Result<File, Error> {
    let path = dir.join("lock");
    let lock = disk::lock(&path).map_err(|e| io_error(&path, e))?;
    lock.ok_or_else(|| Error::InUse { dir: dir.to_owned() })
}

fn id_of(path: &Path) -> Option<Uuid> {
    Uuid::parse_str(path.file_stem()?.to_str()?).ok()
}

fn io_error(path: &Path, source: io::Error) -> Error {
    Error::Io { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests;
