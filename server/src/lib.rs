//! The Echofix service: gRPC for vehicles, HTTP for operators.
//!
//! The rooms, in reading order:
//!
//! - [`args`], [`config`], [`log`]: what the service is told, and where it speaks.
//! - [`run`]: two ports over one store, from bind to the last answer.
//! - [`grpc`]: for vehicles: decode and validate, call the domain, encode.
//! - [`http`]: for operators: map layers, catalog, feeds, probes and the console.
//! - [`mapping`]: from an upload to what the map learns from it.
//! - [`locating`]: from a question to an answer.
//! - [`store`]: the map and the journal it is folded from.
//! - [`feed`]: the last fixes and uploads, for operators to watch; kept in memory only.
//! - [`health`]: is the service alive, is it ready, and if not, why.
//! - [`metrics`]: what the service counts.
//! - [`trace`]: an id and a span for every request, in every log line that belongs to it.

pub mod args;
pub mod config;
pub mod feed;
pub mod grpc;
pub mod health;
pub mod http;
pub mod locating;
pub mod log;
pub mod mapping;
pub mod metrics;
pub mod run;
pub mod store;
pub mod trace;
