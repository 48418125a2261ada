//! Whose store it is, and what its contributors are called in it.

use crate::store::api::Error;

/// Tells whether another server took the store over.
pub(in crate::store) trait Fence: Send + Sync {
    /// Is the store still this server's?
    ///
    /// # Errors
    /// [`Error::Stopped`] when it is not; any other when that cannot be told.
    fn check(&self) -> Result<(), Error>;
}

/// The key that contributors' pseudonyms are hashed with; it never leaves the backend.
pub(in crate::store) trait Pseudonyms: Send + Sync {
    /// The keyed hash of a pseudonym.
    fn hash(&self, pseudonym: &str) -> u64;

    /// What is wrong with the key as it is stored, one sentence for each defect.
    fn damage(&self) -> Vec<String>;
}

/// The object that holds the key, for backups.
pub(in crate::store) const KEY: &str = "key";
