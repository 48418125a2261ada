//! Work that may panic.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::Error;

/// The outcome of work that may panic, as sled does on some damaged files. What it left in memory must
/// not be used.
pub(super) fn caught<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(outcome) => outcome.map_err(|error| error.to_string()),
        Err(_) => Err("it panicked".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_a_failure_like_any_other() {
        assert_eq!(caught(|| Ok(7)), Ok(7));
        assert!(
            caught::<()>(|| Err(Error::Unknown("record 3".to_owned()))).unwrap_err().contains("record 3")
        );
        assert_eq!(caught::<()>(|| panic!("a damaged page")), Err("it panicked".to_owned()));
    }
}
