//! What the service asks of an upload, and how well one agrees with the map.
//!
//! - [`config`](MappingConfig): the limits.
//! - [`agreement`](mod@agreement): how well a contribution agrees with the map that exists.

mod agreement;
mod config;

pub use agreement::agreement;
pub use config::MappingConfig;
