//! From an upload to a contribution: which of its detections count, and where they fall.
//!
//! - [`contribute`](mod@contribute): pure: scans and poses become hits by tile and cell, near a zone border in
//!   every zone whose map holds the place.
//! - [`agreement`](mod@agreement): how well a contribution agrees with the map that exists.

mod agreement;
mod config;
mod contribute;
mod stretch;

pub use agreement::agreement;
pub use config::MappingConfig;
pub use contribute::{Chunk, Contributed, Refusal, Submission, contribute};
