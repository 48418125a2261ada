//! What a cluster is: said once, by whichever server comes first.

use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::body;
use super::client::{Client, Put};
use super::names::{CLUSTER, KEY};
use crate::store::api::{Error, io_error};

const MAGIC: [u8; 4] = *b"EFC\x01";
const KEY_MAGIC: [u8; 4] = *b"EFK\x02";
/// Tiles on the side of a region.
const REGION_TILES: u32 = 128;

/// What all servers of a cluster have in common, for ever.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::store) struct Cluster {
    /// The journal's id.
    pub(in crate::store) journal: Uuid,
    /// How many parts the map is divided into. One so far: regions are not yet divided among shards.
    pub(in crate::store) shards: u32,
    /// Tiles on the side of a region.
    pub(in crate::store) region_tiles: u32,
    /// What lineages are derived from, so that all servers of one policy have the same.
    pub(in crate::store) lineage: u64,
}

impl Cluster {
    /// The cluster of a bucket and the key of its contributors' hashes; made where there is none, with the journal id and the
    /// key that are given, or new ones.
    ///
    /// # Errors
    /// When the store does not answer, or what it holds is damaged, or of another version.
    pub(in crate::store) fn join(
        client: &Client,
        founder: Option<(Uuid, [u8; 16])>,
    ) -> Result<(Self, [u8; 16]), Error> {
        let mut drawn = [0; 24];
        getrandom::fill(&mut drawn)
            .map_err(|error| io_error("drawing a key")(std::io::Error::other(error)))?;
        let (key, lineage) = drawn.split_at(16);
        let (journal, key) = match founder {
            Some(founder) => founder,
            None => (Uuid::now_v7(), key.try_into().expect("it has 16 bytes")),
        };
        let lineage = u64::from_le_bytes(lineage.try_into().expect("it has 8 bytes"));
        // The key first: who finds a cluster finds its key.
        let found = said(client, KEY, &body::wrap(KEY_MAGIC, &key))?;
        let key = body::unwrap(KEY_MAGIC, &found).and_then(|key| key.try_into().ok());
        let key = key.ok_or_else(|| damaged(client, KEY))?;
        let cluster = Self { journal, shards: 1, region_tiles: REGION_TILES, lineage };
        let json = serde_json::to_vec(&cluster).expect("it has no map and no number that JSON lacks");
        let found = said(client, CLUSTER, &body::wrap(MAGIC, &json))?;
        Ok((Self::decoded(client, &found)?, key))
    }

    /// The cluster of a bucket, if there is one.
    ///
    /// # Errors
    /// When the store does not answer, or what it holds is damaged, or of another version.
    pub(in crate::store) fn found(client: &Client) -> Result<Option<Self>, Error> {
        client.get(CLUSTER)?.map(|bytes| Self::decoded(client, &bytes)).transpose()
    }

    fn decoded(client: &Client, bytes: &[u8]) -> Result<Self, Error> {
        let cluster: Option<Self> =
            body::unwrap(MAGIC, bytes).and_then(|json| serde_json::from_slice(json).ok());
        let cluster = cluster.ok_or_else(|| damaged(client, CLUSTER))?;
        if (cluster.shards, cluster.region_tiles) != (1, REGION_TILES) {
            return Err(Error::Unusable(format!(
                "{} has {} shards of regions of {} tiles; this version knows one shard of regions of {REGION_TILES}",
                client.locate(CLUSTER),
                cluster.shards,
                cluster.region_tiles
            )));
        }
        Ok(cluster)
    }
}

/// What was said first.
fn said(client: &Client, name: &str, ours: &[u8]) -> Result<Vec<u8>, Error> {
    if let Some(found) = client.get(name)? {
        return Ok(found);
    }
    match client.put_new(name, ours)? {
        Put::Ours => Ok(ours.to_vec()),
        Put::Theirs(found) => Ok(found),
    }
}

fn damaged(client: &Client, name: &str) -> Error {
    Error::Damaged {
        what: client.locate(name),
        reason:
            "it does not match its checksum, or is of another version. Restore it from a backup of the bucket"
                .to_owned(),
    }
}
