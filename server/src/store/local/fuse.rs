//! After a write that failed nothing more is written: it is not known what the table holds.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;

use crate::store::api::Error;

/// Remembers the first failure.
#[derive(Debug, Default)]
pub(super) struct Fuse(OnceLock<String>);

impl Fuse {
    /// Why nothing is written any more.
    pub(super) fn broken(&self) -> Option<String> {
        self.0.get().cloned()
    }

    /// Writes, unless an earlier write failed. A table may panic on damaged files.
    pub(super) fn write(&self, work: impl FnOnce() -> Result<(), Error>) -> Result<(), Error> {
        if let Some(reason) = self.broken() {
            return Err(Error::Broken(reason));
        }
        let failure = match catch_unwind(AssertUnwindSafe(work)) {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(error)) => error,
            Err(_) => Error::Broken("it panicked".to_owned()),
        };
        let _ = self.0.set(failure.to_string());
        Err(failure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_failure_is_the_last_write() {
        let fuse = Fuse::default();
        fuse.write(|| Ok(())).unwrap();
        assert_eq!(fuse.broken(), None);
        assert!(fuse.write(|| panic!("a damaged page")).is_err());
        let refused = fuse.write(|| unreachable!("nothing more is written"));
        assert!(matches!(refused, Err(Error::Broken(_))));
        assert!(fuse.broken().unwrap().contains("panicked"));
    }
}
