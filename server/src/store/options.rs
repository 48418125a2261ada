//! How the store of one machine is set up.

use std::path::PathBuf;
use std::time::Duration;

use crate::store::api::StoreClock;
use crate::store::local::TableEngine;
use crate::store::map::context::Settings;
use crate::store::map::policy::Policy;

/// How long folding rests after an error.
const RETRY: Duration = Duration::from_secs(2);

/// Where and how an [`crate::store::embedded::EmbeddedStore`] stores its data.
#[derive(Debug, Clone)]
pub struct Options {
    /// The data directory; made if missing.
    pub data_dir: PathBuf,
    /// What tiles are stored in.
    pub table: TableEngine,
    /// Memory for the tile store's cache, bytes; twice that while a new generation of tiles is made.
    pub cache_bytes: u64,
    /// Size from which a journal segment is followed by the next, bytes; at most 1 GiB.
    pub segment_bytes: u64,
    /// Tiles in memory from which on they are written to the tile store before more is folded.
    pub write_buffer_tiles: usize,
    /// Which evidence counts, and what of it is published. Under another policy than before the map is folded
    /// anew, under a new lineage.
    pub policy: Policy,
    /// What day it is.
    pub clock: StoreClock,
    /// Where vehicles reach this service, which others that share its map may tell them.
    pub announce: Option<String>,
}

impl Options {
    /// The usual sizes: a cache of 256 MiB, segments of 64 MiB, and 2048 tiles, which are some hundred megabytes with
    /// what one more upload may add.
    #[must_use]
    pub fn new(data_dir: PathBuf, policy: Policy) -> Self {
        Self {
            data_dir,
            table: TableEngine::default(),
            cache_bytes: 256 << 20,
            segment_bytes: 64 << 20,
            write_buffer_tiles: 2048,
            policy,
            clock: StoreClock::default(),
            announce: None,
        }
    }

    pub(super) fn settings(&self) -> Settings {
        Settings {
            segment_bytes: self.segment_bytes,
            write_buffer_tiles: self.write_buffer_tiles,
            policy: self.policy,
            lineage: None,
            clock: self.clock.clone(),
            retry: RETRY,
        }
    }
}
