//! The map and the journal it is folded from.
//!
//! An upload is acknowledged once its record is in the journal and synced. Tiles are folded
//! from the journal in its order, and can be folded again from nothing. The embedded default has
//! the journal in checksummed segment files and the tiles in sled.
//!
//! The layers. An arrow points to what is used, and none points back up; each layer may also use what its arrows lead to:
//!
//! ```text
//!      embedded
//!      │      │
//!      ▼      │
//!  operations │
//!      │      │
//!      ▼      ▼
//!     map   local
//!      │      │
//!      ▼      │
//!     log     │
//!      │      │
//!      ▼      ▼
//!  backend, checksum
//!         │
//!         ▼
//!        api
//! ```
//!
//! - [`api`]: [`MapStore`], [`Operations`], and their values: what every storage engine offers.
//! - [`backend`]: what the store asks of the place where it is stored, in small traits. Its tests are rules that every
//!   backend keeps, one in memory, and one around any other that lets it fail.
//! - [`log`]: the journal, what its records are, and which of them count.
//! - [`map`]: tiles, folded from the journal: generations, vetting, manifest, checkpoint.
//! - [`operations`]: the map's past, regions, backups, verification.
//! - [`local`]: the backend of one machine: a data directory, with sled in it. No other layer knows a path.
//! - [`object`]: a journal that several servers append to, on an object store. It uses `checksum` and `api` alone.
//! - `replicated`: [`ReplicatedStore`] is an embedded store whose records come in the order of such a journal; its data
//!   directory is a copy.
//! - `embedded` and `options`: [`EmbeddedStore`] puts them together, as its [`Options`] say.
//!
//! Every state of the map is a function of the checkpoint and the journal's records up to the epoch, without what
//! the controls among them exclude. Generations of tiles are that function's values, stored.

mod api;
mod backend;
mod checksum;
mod embedded;
mod local;
mod log;
mod map;
mod object;
mod operations;
mod options;
mod replicated;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;

pub use api::*;
pub use embedded::EmbeddedStore;
pub use local::{TableEngine, free_bytes, journal_bytes};
pub use map::policy::Policy;
pub use options::Options;
pub use replicated::{ReplicatedStore, SharedMap, SharedMapStatus};
