//! What the service asks of an upload.

mod config;

pub use config::MappingConfig;
