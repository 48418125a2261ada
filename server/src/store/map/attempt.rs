//! Work on tiles that may fail or panic.

use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::store::api::Error;

/// Why tiles cannot be used.
#[derive(Debug, thiserror::Error)]
pub(in crate::store) enum TilesError {
    #[error("they are gone")]
    Gone,
    #[error("they were folded from another journal")]
    OtherJournal,
    #[error("it is not said how far they are folded")]
    NoState,
    #[error("how far they are folded is damaged")]
    StateDamaged,
    #[error("some are missing or older than the others")]
    Incomplete,
    #[error("the key {0:?} is of nothing that is stored here")]
    UnknownKey(Vec<u8>),
    #[error(transparent)]
    Store(#[from] Error),
    #[error("it panicked")]
    Panicked,
}

impl TilesError {
    /// See [`Error::may_pass`].
    pub(super) fn may_pass(&self) -> bool {
        matches!(self, Self::Store(error) if error.may_pass())
    }
}

/// The outcome of work that may panic, as sled does on some damaged files. What it left in memory must
/// not be used.
pub(super) fn caught<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, TilesError> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(outcome) => Ok(outcome?),
        Err(_) => Err(TilesError::Panicked),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_a_failure_like_any_other() {
        assert_eq!(caught(|| Ok(7)).unwrap(), 7);
        let failed = caught::<()>(|| Err(Error::Unknown("record 3".to_owned())));
        assert!(matches!(failed, Err(TilesError::Store(Error::Unknown(_)))));
        assert!(matches!(caught::<()>(|| panic!("a damaged page")), Err(TilesError::Panicked)));
    }
}
