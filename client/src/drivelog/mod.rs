//! Drives on disk: one MCAP file, or a folder of CSV files. Both hold all of a
//! [`Drive`](echofix_core::drive::Drive) and give back exactly what was written.
//!
//! - `*.mcap` (feature `mcap`): protobuf messages in zstd chunks with their schemas embedded, as Foxglove and the
//!   MCAP tools open them; see `topic`.
//! - anything else (feature `csv`): a folder of CSV files for spreadsheets and scripts, each of which may be
//!   gzipped (`scans.csv.gz`); the columns are those of `tables`.
//!
//! A long log has flaws. What cannot be used of it is skipped, counted and told by reason with its first place ([`Flaws`]); all
//! else is read. `read` detects which it is, `write` goes by the ending of the path. [`replay`](replay()) needs neither feature.

#[cfg(any(feature = "mcap", feature = "csv"))]
mod error;
#[cfg(any(feature = "mcap", feature = "csv"))]
mod file;
#[cfg(any(feature = "mcap", feature = "csv"))]
mod flaws;
#[cfg(any(feature = "mcap", feature = "csv"))]
mod jumps;
#[cfg(feature = "mcap")]
mod mcap;
#[cfg(any(feature = "mcap", feature = "csv"))]
mod order;
#[cfg(any(feature = "mcap", feature = "csv"))]
mod problem;
mod replay;
#[cfg(any(feature = "mcap", feature = "csv"))]
mod scans;
#[cfg(feature = "csv")]
mod stamp;
#[cfg(feature = "csv")]
pub mod tables;

#[cfg(feature = "mcap")]
pub use self::mcap::topic;
#[cfg(any(feature = "mcap", feature = "csv"))]
pub use error::Error;
#[cfg(any(feature = "mcap", feature = "csv"))]
pub use file::{DriveLog, read, write};
#[cfg(any(feature = "mcap", feature = "csv"))]
pub use flaws::{Flaws, Skipped};
#[cfg(any(feature = "mcap", feature = "csv"))]
pub use problem::Problem;
pub use replay::{DriveEvent, replay};
