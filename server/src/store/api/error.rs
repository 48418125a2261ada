//! Why the store could not do what was asked.

/// Why the store could not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The disk refused.
    #[error("{doing}: {source}")]
    Io {
        /// The step that failed, as a phrase: "writing the journal".
        doing: &'static str,
        /// What the operating system reported.
        source: std::io::Error,
    },
    /// The tile store refused.
    #[error("tile store: {reason}")]
    Tiles {
        /// What it reported.
        reason: String,
        /// What the operating system reported, if it was that.
        io: Option<std::io::ErrorKind>,
    },
    /// The tile store failed before, and takes nothing more. Another one is made in its place.
    #[error("the tile store failed: {0}")]
    Broken(String),
    /// The disk is so full that nothing but the journal is written.
    #[error("{free_mib} MiB are free in {dir}, and folding needs {needed_mib}; free some")]
    NoRoom {
        /// The data directory.
        dir: String,
        /// What is free, MiB.
        free_mib: u64,
        /// What must be, MiB.
        needed_mib: u64,
    },
    /// Stored bytes do not pass their checks.
    #[error("{what} is damaged: {reason}")]
    Damaged {
        /// The record, tile or file.
        what: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Another process has the data directory open.
    #[error("{0} is in use by another server; give each its own data directory")]
    InUse(String),
    /// The map is being folded from the journal and is not whole yet.
    #[error("the map is being rebuilt: {folded} of {journaled} uploads are folded; try again later")]
    Rebuilding {
        /// The last record folded.
        folded: u64,
        /// The last record in the journal.
        journaled: u64,
    },
    /// There is nothing under this name.
    #[error("{0}")]
    Unknown(String),
    /// What was given cannot be used.
    #[error("{0}")]
    Unusable(String),
    /// The store accepts nothing any more: another service has its directory, or it is being closed.
    #[error("the store stopped: {0}")]
    Stopped(String),
}

/// An I/O error at a step.
pub(in crate::store) fn io_error(doing: &'static str) -> impl Fn(std::io::Error) -> Error {
    move |source| Error::Io { doing, source }
}

impl Error {
    /// May it be otherwise without anybody mending what is stored? Of a tile store's errors only those that say nothing of
    /// its files: a disk that is full or read-only. What cannot be read may stay so.
    pub(in crate::store) fn may_pass(&self) -> bool {
        use std::io::ErrorKind::{
            FileTooLarge, PermissionDenied, QuotaExceeded, ReadOnlyFilesystem, StorageFull,
        };
        match self {
            Self::Io { .. } | Self::NoRoom { .. } | Self::Broken(_) => true,
            Self::Tiles { io: Some(kind), .. } => matches!(
                kind,
                FileTooLarge | PermissionDenied | QuotaExceeded | ReadOnlyFilesystem | StorageFull
            ),
            _ => false,
        }
    }
}
