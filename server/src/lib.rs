//! The Echofix service: gRPC for vehicles, HTTP for operators.
//!
//! The modules, in reading order:
//!
//! - [`args`], [`config`], [`log`]: its settings, and its log.
//! - `outgoing`: what the service itself asks over HTTP.
//! - [`pace`]: how slowly a peer may send.
//! - [`patience`]: how long a caller waits for blocking work.
//! - [`lanes`]: which threads do what, and which of them come first.
//! - [`port`]: the two ports; [`listen`]: where they listen.
//! - [`shares`]: pools of which no peer can take all.
//! - `sparse`: log lines that a caller can cause, at a bounded rate.
//! - [`run`]: two ports over one store, from bind to the last answer.
//! - [`identity`]: who is there, and what they may do; the same for both ports.
//! - [`grpc`]: for vehicles: decode and validate, call the domain, encode.
//! - [`http`]: for operators: map layers, catalog, feeds, probes and the console.
//! - [`mapping`]: what an upload must fulfil.
//! - [`locating`]: from a request to a fix.
//! - [`store`]: the map and the journal it is folded from.
//! - [`event_log`]: what happened of late, numbered, for those who listen.
//! - [`access_log`]: one line a call.
//! - [`feed`]: the last fixes and uploads, for operators to watch; in memory only.
//! - [`health`]: is the service alive, is it ready, and if not, why.
//! - [`metrics`]: what the service counts.
//! - [`export`]: the spans of calls, to a collector.
//! - [`trace`]: an id and a span for every request, in every log line that belongs to it.

pub mod access_log;
pub mod args;
pub mod config;
pub mod event_log;
pub mod export;
pub mod feed;
pub mod grpc;
pub mod health;
pub mod http;
pub mod identity;
pub mod lanes;
pub mod listen;
pub mod locating;
pub mod log;
pub mod mapping;
pub mod metrics;
mod outgoing;
pub mod pace;
pub mod patience;
pub mod port;
mod rpc_code;
pub mod run;
pub mod shares;
mod sparse;
pub mod store;
pub mod trace;
