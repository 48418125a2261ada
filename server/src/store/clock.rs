//! What day it is.

use std::time::{SystemTime, UNIX_EPOCH};

use echofix_core::time::day_of;

/// Microseconds since the Unix epoch.
pub(super) fn now_us() -> i64 {
    #[cfg(test)]
    if let Some(day) = tests::TODAY.get() {
        return i64::from(day) * echofix_core::time::DAY_US;
    }
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_micros() as i64)
}

/// The UTC day, counted from the Unix epoch.
pub(super) fn today() -> u16 {
    day_of(now_us())
}

#[cfg(test)]
pub(super) mod tests {
    use std::cell::Cell;

    thread_local! {
        /// What a test says the day is, for calls of its own thread.
        pub(in crate::store) static TODAY: Cell<Option<u16>> = const { Cell::new(None) };
    }
}
