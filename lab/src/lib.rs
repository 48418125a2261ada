//! The laboratory: how good the fixes are, and what they cost. Neither the service nor a vehicle uses it.
//!
//! - [`evaluate`]: the paper's experiments and further ones, in one process; this is `echofix evaluate`.
//! - [`mod@bench`]: what a fix and an upload cost on this machine; this is `echofix bench`.
//! - [`sizing`]: what a fleet asks of several replicas, simulated from measured costs; this is `echofix sizing`.
//! - [`request`]: a vehicle's request, as the service takes it.
//! - [`report`]: writes generated sections into the pages of `docs/benchmarks`.
//! - [`machine`]: the machine that the figures were measured on.
#![allow(clippy::print_stdout, reason = "printing is what a command does")]

pub mod bench;
pub mod evaluate;
mod machine;
mod report;
mod request;
pub mod sizing;
