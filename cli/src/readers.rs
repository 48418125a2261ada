//! Whoever reads standard output may leave, as `head` does: the command then ends, without a word.

use std::panic::{self, AssertUnwindSafe};

/// The exit code then: what shells give a program that ended by SIGPIPE.
pub const GONE: u8 = 141;

/// From now on a reader that left is no panic that is told.
pub fn may_leave() {
    let usual = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        if !left(info.payload_as_str()) {
            usual(info);
        }
    }));
}

/// Does work that prints; `None` when the reader left meanwhile.
pub fn read_to_the_end<T>(work: impl FnOnce() -> T) -> Option<T> {
    match panic::catch_unwind(AssertUnwindSafe(work)) {
        Ok(done) => Some(done),
        Err(panic) => {
            let told = panic.downcast_ref::<String>().map(String::as_str);
            if left(told) { None } else { panic::resume_unwind(panic) }
        }
    }
}

/// `print!` panics so when nobody reads.
fn left(panic: Option<&str>) -> bool {
    panic.is_some_and(|told| told.starts_with("failed printing to std") && told.contains("Broken pipe"))
}
