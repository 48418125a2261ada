//! How the store of one machine is set up.

use std::path::PathBuf;

use super::Policy;

/// Where and how an [`super::EmbeddedStore`] keeps its data.
#[derive(Debug, Clone)]
pub struct Options {
    /// The data directory; made if missing.
    pub data_dir: PathBuf,
    /// Memory for sled's cache, bytes; twice that while a new generation of tiles is made.
    pub cache_bytes: u64,
    /// Size from which a journal segment is followed by the next, bytes; at most 1 GiB.
    pub segment_bytes: u64,
    /// What counts and what is served. Under another policy than before the map is folded
    /// anew, and of a new lineage.
    pub policy: Policy,
}
