//! The layout of a data directory.
//!
//! ```text
//! lock       held while a server runs
//! key        16 random bytes, mode 0600: what contributors' pseudonyms are hashed with
//! journal/   the source of truth
//! base-<n>   the source of truth for the records up to n that were compacted
//! manifest   which tiles are served
//! tiles-<n>/ sled, a generation of tiles; folded from checkpoint and journal, may be deleted while no server runs
//! ```

use std::fs::{self, File, OpenOptions, TryLockError};
use std::hash::Hasher;
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use siphasher::sip::SipHasher24;

use super::journal::Journal;
use super::{Error, io_error};

/// Ends the names of files that are being written.
const UNFINISHED: &str = ".new";
/// Tiles that are folded to be compacted.
const SCRATCH: &str = "scratch";

/// A locked data directory.
pub(super) struct DataDir {
    root: PathBuf,
    key: [u8; 16],
    /// The lock lives as long as the file is open.
    _lock: File,
}

impl DataDir {
    /// Opens a data directory, creating what is missing.
    pub(super) fn open(root: &Path) -> Result<Self, Error> {
        fs::create_dir_all(root.join("journal")).map_err(io_error("creating the data directory"))?;
        let lock = File::create(root.join("lock")).map_err(io_error("creating the lock file"))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(Error::InUse(root.display().to_string())),
            Err(TryLockError::Error(error)) => return Err(io_error("locking the data directory")(error)),
        }
        let named = root.join("key").try_exists().map_err(io_error("reading the key"))?;
        if !named && Journal::holds_records(&root.join("journal"))? {
            return Err(key_is_missing(root));
        }
        let key = key(root).map_err(io_error("reading or creating the key"))?;
        sync_dir(root).map_err(io_error("syncing the data directory"))?;
        if let Some(parent) = root.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            sync_dir(parent).map_err(io_error("syncing the data directory's parent"))?;
        }
        Ok(Self { root: root.to_owned(), key, _lock: lock })
    }

    pub(super) fn journal(&self) -> PathBuf {
        self.root.join("journal")
    }

    pub(super) fn root(&self) -> &Path {
        &self.root
    }

    /// The directory of a generation of tiles.
    pub(super) fn generation(&self, number: u64) -> PathBuf {
        self.root.join(format!("tiles-{number}"))
    }

    /// A number that no generation on disk has.
    pub(super) fn next_generation(&self) -> Result<u64, Error> {
        let numbers =
            self.names()?.into_iter().filter_map(|name| name.strip_prefix("tiles-")?.parse::<u64>().ok());
        Ok(numbers.max().unwrap_or(0) + 1)
    }

    /// Removes all tiles but those of a generation, and whatever unfinished work left over.
    pub(super) fn remove_all_but(&self, generation: Option<u64>) -> Result<(), Error> {
        let current = generation.map(|number| format!("tiles-{number}"));
        for name in self.names()? {
            let tiles = name.starts_with("tiles") || name == SCRATCH;
            let unfinished = name.ends_with(UNFINISHED);
            let path = self.root.join(&name);
            if tiles && current.as_ref() != Some(&name) {
                fs::remove_dir_all(path).map_err(io_error("removing old tiles"))?;
            } else if unfinished {
                fs::remove_file(path).map_err(io_error("removing an unfinished file"))?;
            }
        }
        Ok(())
    }

    /// Where tiles are folded that are not served.
    pub(super) fn scratch(&self) -> PathBuf {
        self.root.join(SCRATCH)
    }

    fn names(&self) -> Result<Vec<String>, Error> {
        let listing = "listing the data directory";
        let mut names = Vec::new();
        for entry in fs::read_dir(&self.root).map_err(io_error(listing))? {
            names.extend(entry.map_err(io_error(listing))?.file_name().into_string());
        }
        Ok(names)
    }

    /// SipHash-2-4 of a contributor's pseudonym under this directory's key.
    pub(super) fn contributor(&self, pseudonym: &str) -> u64 {
        let mut hasher = SipHasher24::new_with_key(&self.key);
        hasher.write(pseudonym.as_bytes());
        hasher.finish()
    }
}

/// The key, made once. It gets its name only when all of it is on disk.
fn key(root: &Path) -> io::Result<[u8; 16]> {
    let path = root.join("key");
    match fs::read(&path) {
        Ok(bytes) => {
            let length = bytes.len();
            let wrong = || io::Error::other(format!("{} holds {length} bytes, expected 16", path.display()));
            return bytes.try_into().map_err(|_| wrong());
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let mut key = [0; 16];
    getrandom::fill(&mut key).map_err(io::Error::other)?;
    put_file_with(root, "key", 0o600, |file| file.write_all(&key))?;
    Ok(key)
}

/// Under a new key every contributor would count again, as another one.
fn key_is_missing(root: &Path) -> Error {
    Error::Damaged {
        what: format!("the data directory {}", root.display()),
        reason: "its journal holds uploads but the file `key` is missing. Restore it from a backup, or put \
                 16 random bytes there to go on with every contributor counted as a new one"
            .to_owned(),
    }
}

/// Writes a file that gets its name only when all of it is on disk; the name is on disk, too, when this
/// returns.
pub(super) fn put_file(
    root: &Path,
    name: &str,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    put_file_with(root, name, 0o644, write)
}

fn put_file_with(
    root: &Path,
    name: &str,
    mode: u32,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let unnamed = root.join(format!("{name}{UNFINISHED}"));
    let file = OpenOptions::new().create(true).write(true).truncate(true).mode(mode).open(&unnamed)?;
    let mut file = BufWriter::new(file);
    write(&mut file)?;
    file.into_inner()?.sync_all()?;
    fs::rename(unnamed, root.join(name))?;
    sync_dir(root)
}

fn sync_dir(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_directory_belongs_to_one_server_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let first = DataDir::open(dir.path()).unwrap();
        assert!(matches!(DataDir::open(dir.path()), Err(Error::InUse(_))));
        drop(first);
        assert!(DataDir::open(dir.path()).is_ok());
    }

    #[test]
    fn the_key_is_private_lasting_and_its_own() {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let hash = |dir: &Path| DataDir::open(dir).unwrap().contributor("car-7");
        assert_eq!(hash(one.path()), hash(one.path()));
        assert_ne!(hash(one.path()), hash(other.path()));
        let mode = fs::metadata(one.path().join("key")).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        fs::write(one.path().join("key"), "short").unwrap();
        assert!(DataDir::open(one.path()).is_err(), "a damaged key is not replaced");
    }
}
