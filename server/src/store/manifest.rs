//! Which generation of tiles is served, under which controls and which policy it was made, and of which lineage
//! it is.
//!
//! ```text
//! magic "EFM" 3 (4) | CRC-32C of the rest (4) | journal id (16) | generation (8) | control (8) | lineage (8) | policy (8)
//! ```
//!
//! The numbers are little-endian.

use std::io::Write;
use std::path::Path;

use uuid::Uuid;

use super::data_dir::put_file;
use super::{Error, io_error};

const MAGIC: [u8; 4] = *b"EFM\x03";
const LENGTH: usize = 56;
const NAME: &str = "manifest";

/// The manifest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Manifest {
    pub(super) journal: Uuid,
    /// Number of the generation that is served.
    pub(super) generation: u64,
    /// The last control it was made under; 0 for none.
    pub(super) applied: u64,
    /// See [`super::MapStore::lineage`].
    pub(super) lineage: u64,
    /// See [`super::Policy::digest`].
    pub(super) policy: u64,
}

impl Manifest {
    /// The manifest of a data directory; `None` where there is no sound one.
    pub(super) fn read(root: &Path) -> Option<Self> {
        let bytes = std::fs::read(root.join(NAME)).ok()?;
        let manifest = Self::parse(&bytes);
        if manifest.is_none() {
            tracing::warn!("the manifest is damaged");
        }
        manifest
    }

    /// Puts the manifest in place: it is on disk, whole, when this returns.
    pub(super) fn write(&self, root: &Path) -> Result<(), Error> {
        put_file(root, NAME, |file| file.write_all(&self.bytes())).map_err(io_error("writing the manifest"))
    }

    fn bytes(&self) -> [u8; LENGTH] {
        let mut bytes = [0; LENGTH];
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[8..24].copy_from_slice(self.journal.as_bytes());
        bytes[24..32].copy_from_slice(&self.generation.to_le_bytes());
        bytes[32..40].copy_from_slice(&self.applied.to_le_bytes());
        bytes[40..48].copy_from_slice(&self.lineage.to_le_bytes());
        bytes[48..].copy_from_slice(&self.policy.to_le_bytes());
        let checksum = crc32c::crc32c(&bytes[8..]);
        bytes[4..8].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; LENGTH] = bytes.try_into().ok()?;
        let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let journal = Uuid::from_slice(&bytes[8..24]).ok()?;
        let (generation, applied, lineage, policy) = (word(24), word(32), word(40), word(48));
        let manifest = Self { journal, generation, applied, lineage, policy };
        (manifest.bytes() == *bytes).then_some(manifest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_manifest_is_read_whole_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(Manifest::read(dir.path()), None);
        let journal = Uuid::from_u128(3);
        let manifest = Manifest { journal, generation: 4, applied: 9, lineage: 11, policy: 12 };
        manifest.write(dir.path()).unwrap();
        assert_eq!(Manifest::read(dir.path()), Some(manifest));
        let good = std::fs::read(dir.path().join(NAME)).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 32;
            assert_eq!(Manifest::parse(&bad), None, "byte {at}");
            assert_eq!(Manifest::parse(&good[..at]), None);
        }
    }
}
