//! The layout of a data directory.
//!
//! ```text
//! lock         held while a server runs; the directory itself is locked, too, and its journal
//! writer       whose store it is by now: the second line behind the locks
//! key          what contributors' pseudonyms are hashed with, checksummed, mode 0600; key-copy is its copy
//! journal/     the source of truth
//! base-<n>     the source of truth for the records up to n that were compacted
//! manifest     which tiles are served
//! tiles-<n>/   sled, a generation of tiles; folded from checkpoint and journal, may be deleted while no server runs
//! scratch-<n>/ tiles that are folded to be compacted
//! ballast      room for a start on a full disk
//! set-aside/   what contradicts the journal, kept for whoever runs the store
//! ```
//!
//! Nothing is deleted or overwritten here that this store did not make: its directories of tiles hold a marker
//! ([`super::marker`]), and files that are being written have names of their own ([`super::files`]).

use std::fs;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use uuid::Uuid;

use super::contributor_key::ContributorKey;
use super::fence::Fence;
use super::files::at;
use super::lock::Locks;
use super::marker::{self, TILES, marked};
use super::{files, segments, traces};
use crate::store::api::Error;
use crate::store::backend::owner::Pseudonyms;
use crate::store::backend::tables::{TableId, TableUse};

/// How the names of tiles begin that are folded to be compacted.
const SCRATCH: &str = "scratch-";
/// Where the source of truth lies.
pub(super) const JOURNAL: &str = "journal";
/// Where it lies what contradicts the journal.
const SET_ASIDE: &str = "set-aside";

/// A locked data directory.
pub(super) struct DataDir {
    root: PathBuf,
    key: ContributorKey,
    fence: Fence,
    _locks: Locks,
}

impl DataDir {
    /// Opens a data directory, creating what is missing. Nothing is created in one that lost its journal.
    pub(super) fn open(root: &Path) -> Result<Self, Error> {
        let creating = "creating the data directory";
        let mut builder = fs::DirBuilder::new();
        builder.recursive(true).mode(0o700).create(root).map_err(at(root, creating))?;
        refuse_foreign(root)?;
        let mut locks = Locks::of(root)?;
        let journal = root.join(JOURNAL);
        if !segments::any(&journal)? {
            traces::none(root, &journal)?;
            builder.create(&journal).map_err(at(&journal, creating))?;
        }
        locks.hold(&journal)?;
        let key = ContributorKey::open(root, segments::holds_records(&journal)?)?;
        let fence = Fence::take(root)?;
        files::sync_dir(root).map_err(at(root, "syncing the data directory"))?;
        if let Some(parent) = root.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            files::sync_dir(parent).map_err(at(parent, "syncing the data directory's parent"))?;
        }
        Ok(Self { root: root.to_owned(), key, fence, _locks: locks })
    }

    pub(super) fn journal(&self) -> PathBuf {
        self.root.join(JOURNAL)
    }

    pub(super) fn root(&self) -> &Path {
        &self.root
    }

    /// Tells whether another server took the directory over.
    pub(super) fn fence(&self) -> &Fence {
        &self.fence
    }

    /// The directory of a table.
    pub(super) fn table(&self, id: TableId) -> PathBuf {
        let prefix = match id.used {
            TableUse::Served => TILES,
            TableUse::Scratch => SCRATCH,
        };
        self.root.join(format!("{prefix}{}", id.number))
    }

    /// A number that is free: nothing on disk has a name with it, whoever made that.
    pub(super) fn next_generation(&self) -> Result<u64, Error> {
        let names = files::names(&self.root)?;
        let number = |name: &String| {
            name.strip_prefix(TILES).or_else(|| name.strip_prefix(SCRATCH))?.parse::<u64>().ok()
        };
        let taken: Vec<u64> = names.iter().filter_map(number).collect();
        let sensible = taken.iter().copied().filter(|number| *number < u64::MAX / 2).max().unwrap_or(0);
        Ok(sensible + 1)
    }

    /// Removes tiles that this store made and no longer needs, and files it did not finish. `replaced` says that the
    /// manifest is sound: then other generations of its journal are older ones, or unfinished. Without it they may hold
    /// what the journal lost, and are set aside.
    pub(super) fn clean(&self, journal: Uuid, current: Option<u64>, replaced: bool) -> Result<(), Error> {
        files::remove_unfinished(&self.root)?;
        let current = current.map(|number| format!("{TILES}{number}"));
        for name in files::names(&self.root)? {
            let numbered = |prefix| name.strip_prefix(prefix).is_some_and(|n: &str| n.parse::<u64>().is_ok());
            let (tiles, scratch) = (numbered(TILES), numbered(SCRATCH));
            if current.as_ref() == Some(&name) || !(tiles || scratch || name == "scratch") {
                continue;
            }
            let path = self.root.join(&name);
            match marked(&path) {
                Some(of) if of == journal && (scratch || replaced) => {
                    marker::remove(&path).map_err(at(&path, "removing old tiles"))?;
                }
                Some(_) => self.set_aside(&name, "tiles that do not belong to this journal and manifest")?,
                None => {
                    tracing::warn!(path = %path.display(), "nothing says that this store made it; left alone");
                }
            }
        }
        Ok(())
    }

    /// Moves what contradicts the journal out of the way. It is never deleted.
    pub(super) fn set_aside(&self, name: &str, why: &str) -> Result<(), Error> {
        let dir = self.root.join(SET_ASIDE);
        let doing = "setting aside what contradicts the journal";
        fs::DirBuilder::new().recursive(true).mode(0o700).create(&dir).map_err(at(&dir, doing))?;
        let mut to = dir.join(name);
        let mut count = 1;
        while to.symlink_metadata().is_ok() {
            count += 1;
            to = dir.join(format!("{name}.{count}"));
        }
        fs::rename(self.root.join(name), &to).map_err(at(&to, doing))?;
        files::sync_dir(&dir).and_then(|()| files::sync_dir(&self.root)).map_err(at(&dir, doing))?;
        tracing::warn!(%name, to = %to.display(), why, "set aside; look at it, then delete it or restore from it");
        Ok(())
    }
}

/// Bytes of the segments of the journal in a data directory.
///
/// # Errors
/// When they cannot be listed.
pub fn journal_bytes(root: &Path) -> Result<u64, Error> {
    let journal = root.join(JOURNAL);
    let entries = fs::read_dir(&journal).map_err(at(&journal, "listing the journal's segments"))?;
    let sizes = entries.flatten().filter_map(|entry| entry.metadata().ok());
    Ok(sizes.map(|size| size.len()).sum())
}

impl Pseudonyms for DataDir {
    fn hash(&self, pseudonym: &str) -> u64 {
        self.key.hash(pseudonym)
    }

    fn damage(&self) -> Vec<String> {
        self.key.damage(&self.root)
    }
}

/// Refuses a directory that holds other things than a store, and nothing of a store: it was named by mistake.
pub(super) fn refuse_foreign(root: &Path) -> Result<(), Error> {
    let names = files::names(root)?;
    let ours = [JOURNAL, "manifest", "key", "key-copy", "writer", "ballast", SET_ASIDE];
    let numbered = [TILES, SCRATCH, "base-"];
    let is_ours = |name: &String| {
        ours.contains(&name.as_str()) || numbered.iter().any(|prefix| name.starts_with(prefix))
    };
    if names.iter().any(is_ours) {
        return Ok(());
    }
    match names.iter().find(|name| !["lock", "lost+found"].contains(&name.as_str())) {
        Some(stranger) => Err(Error::Unusable(format!(
            "{} holds `{stranger}` and nothing of a store: give the service an empty data directory, or a new one",
            root.display()
        ))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
