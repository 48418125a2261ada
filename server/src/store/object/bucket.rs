//! Single requests to a bucket.

use std::ops::Range;

/// Why a request has no answer.
#[derive(Debug, Clone, thiserror::Error)]
pub(in crate::store) enum Failure {
    /// It may have been done, and may be done later still: a time-out, a broken connection, an error of the server.
    #[error("{0}")]
    Unknown(String),
    /// The store will not do it, however often it is asked: no right to, no such bucket.
    #[error(
        "{0}; check AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT_URL and the bucket's rights"
    )]
    Refused(String),
}

/// What became of a creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) enum Created {
    /// The object was put.
    Won,
    /// The name has one. It may be this very one: a server repeats what it was asked, or a connection does.
    Taken,
}

/// An object in a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::store) struct Listed {
    /// Its name, without the bucket's prefix.
    pub(in crate::store) name: String,
    /// Its bytes.
    pub(in crate::store) bytes: u64,
    /// When it was put, by the store's clock, microseconds since the Unix epoch.
    pub(in crate::store) modified_us: i64,
}

/// A bucket, or a folder of one. Each call is one request, and waits for its answer: keep it off the async threads.
pub(in crate::store) trait Bucket: Send + Sync {
    /// Puts an object if there is none of its name.
    ///
    /// # Errors
    /// When there is no answer.
    fn create(&self, name: &str, body: &[u8]) -> Result<Created, Failure>;

    /// An object, or some bytes of it, fewer where it ends before; `None` where there is none.
    ///
    /// # Errors
    /// When there is no answer.
    fn get(&self, name: &str, range: Option<Range<u64>>) -> Result<Option<Vec<u8>>, Failure>;

    /// The objects whose names begin with a folder's. A list may be old.
    ///
    /// # Errors
    /// When there is no answer.
    fn list(&self, folder: &str) -> Result<Vec<Listed>, Failure>;

    /// Deletes an object; one that is not there is no error.
    ///
    /// # Errors
    /// When there is no answer.
    fn delete(&self, name: &str) -> Result<(), Failure>;

    /// Where it is, for whoever runs it.
    fn locate(&self, name: &str) -> String;
}
