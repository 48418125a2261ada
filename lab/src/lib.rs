//! The laboratory: how good Echofix's answers are, and what they cost. Nothing of it runs in the service or on a
//! vehicle.
//!
//! - [`evaluate`]: the paper's experiments and more, in one process: `echofix evaluate`.
//! - [`mod@bench`]: what a fix and an upload cost on this machine: `echofix bench`.
//! - [`report`]: generated sections of written pages.
//! - [`machine`]: what figures were made on.
#![allow(clippy::print_stdout, reason = "printing is what a command does")]

pub mod bench;
pub mod evaluate;
pub mod machine;
pub mod report;
