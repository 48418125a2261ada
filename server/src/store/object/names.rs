//! The names of objects.

use uuid::Uuid;

/// What a cluster is.
pub(in crate::store) const CLUSTER: &str = "cluster";
/// The key of its contributors' hashes.
pub(in crate::store) const KEY: &str = "key";

/// The names of one shard's objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct Shard(pub(in crate::store) u32);

impl Shard {
    /// The folder of its journal.
    pub(in crate::store) fn journal(self) -> String {
        format!("s/{}/j", self.0)
    }

    /// A segment of its journal.
    pub(in crate::store) fn segment(self, seq: u64) -> String {
        format!("s/{}/j/{seq:020}", self.0)
    }

    /// A manifest.
    pub(in crate::store) fn manifest(self, epoch: u64) -> String {
        format!("s/{}/m/{epoch:020}", self.0)
    }

    /// The folder of its packs.
    pub(in crate::store) fn packs(self) -> String {
        format!("s/{}/p", self.0)
    }

    /// A pack that is made for the manifest of an epoch, and for no other.
    pub(in crate::store) fn pack(self, epoch: u64, id: Uuid) -> String {
        format!("s/{}/p/{epoch:020}-{id}", self.0)
    }

    /// The folder of the addresses of services that share the map.
    pub(in crate::store) fn announcements(self) -> String {
        format!("s/{}/a", self.0)
    }

    /// A service's announcement of its address: each time another one.
    pub(in crate::store) fn announcement(self, writer: Uuid, number: u64) -> String {
        format!("s/{}/a/{}-{number:020}", self.0, writer.simple())
    }

    /// What is put and deleted to see whether the store takes anything.
    pub(in crate::store) fn trial(self, id: Uuid) -> String {
        format!("s/{}/w/{id}", self.0)
    }
}

/// The number of a segment, by its name.
pub(in crate::store) fn seq_of(name: &str) -> Option<u64> {
    name.rsplit('/').next()?.parse().ok()
}

/// Who made an announcement, and which of its own it is, by its name.
pub(in crate::store) fn announced(name: &str) -> Option<(Uuid, u64)> {
    let (writer, number) = name.rsplit('/').next()?.split_once('-')?;
    Some((Uuid::parse_str(writer).ok()?, number.parse().ok()?))
}

/// The epoch of the manifest that a pack was made for, by its name.
pub(in crate::store) fn epoch_of(pack: &str) -> Option<u64> {
    pack.rsplit('/').next()?.split_once('-')?.0.parse().ok()
}
