//! The manifest, of which the newest counts.

use crate::store::api::Error;

/// Manifests, one after the other. A backend may store one that is swapped, or a chain of names each of which is put if
/// it is absent.
pub(in crate::store) trait Manifests: Send + Sync {
    /// The newest manifest; `None` where there is none. What is in its place and cannot be one is no bytes.
    ///
    /// # Errors
    /// When the backend refuses.
    fn newest(&self) -> Result<Option<Vec<u8>>, Error>;

    /// Puts a manifest after the newest: it is durable, whole, when this returns. After a failure it is the newest, or the
    /// one before is.
    ///
    /// # Errors
    /// [`Error::Stopped`] when another writer took over, whose manifest stays; or when the backend refuses.
    fn publish(&self, manifest: &[u8]) -> Result<(), Error>;

    /// Keeps the newest manifest elsewhere, for whoever runs the store; then there is none.
    ///
    /// # Errors
    /// When the backend refuses.
    fn set_aside(&self, why: &str) -> Result<(), Error>;
}
