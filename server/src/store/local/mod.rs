//! Files and sled: the only modules that know paths.
//!
//! - [`data_dir`]: the layout of a data directory; [`lock`], [`fence`]: one server at a time; [`contributor_key`]: what
//!   pseudonyms are hashed with; [`files`]: files that are whole or not there; [`marker`], [`traces`]: what this store made.
//! - [`sled_instance`]: one instance of sled; [`room`]: how much room a disk has left.

mod contributor_key;
pub(in crate::store) mod data_dir;
pub(in crate::store) mod fence;
pub(in crate::store) mod files;
mod lock;
pub(in crate::store) mod marker;
pub(in crate::store) mod room;
pub(in crate::store) mod sled_instance;
mod traces;
