//! What a manifest says: from where on the journal is there, and what stands for what is not.

use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::body;

const MAGIC: [u8; 4] = *b"EFN\x01";

/// A manifest. Before the first one is published, the one of epoch 0 holds: nothing was ever deleted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::store) struct Manifest {
    /// Its number; its parent has the one before.
    pub(in crate::store) epoch: u64,
    /// The opening of a server that published it.
    pub(in crate::store) owner: Uuid,
    /// Segments from this one on are there. What lies below may be deleted at any time from now on.
    pub(in crate::store) floor: u64,
    /// Number of the first record of that segment.
    pub(in crate::store) first: u64,
    /// The pack that stands for the records before `next`; `None` while all of them are there.
    pub(in crate::store) pack: Option<String>,
    /// Number of the first record that is not in the pack.
    pub(in crate::store) next: u64,
}

impl Manifest {
    /// What holds before any was published.
    pub(in crate::store) fn initial() -> Self {
        Self { epoch: 0, owner: Uuid::nil(), floor: 1, first: 1, pack: None, next: 1 }
    }

    pub(in crate::store) fn encode(&self) -> Vec<u8> {
        let json = serde_json::to_vec(self).expect("it has no map and no number that JSON lacks");
        body::wrap(MAGIC, &json)
    }

    /// `None` when it is damaged.
    pub(in crate::store) fn decode(bytes: &[u8]) -> Option<Self> {
        serde_json::from_slice(body::unwrap(MAGIC, bytes)?).ok()
    }
}
