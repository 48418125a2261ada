//! The Echofix service: gRPC for vehicles, HTTP for operators.
//!
//! The rooms, in reading order:
//!
//! - [`store`]: the map and the journal it is folded from.
//! - [`feed`]: the last fixes and uploads, for operators to watch; kept in memory only.
//! - [`health`]: is the service alive, is it ready, and if not, why.
//! - [`metrics`]: what the service counts.

pub mod feed;
pub mod health;
pub mod metrics;
pub mod store;
