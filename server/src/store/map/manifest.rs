//! Which generation of tiles is served, under which controls and which policy it was made, and of which lineage
//! it is.
//!
//! ```text
//! magic "EFM" 4 (4) | CRC-32C of the rest (4) | journal id (16) | generation (8) | control (8) | lineage (8) | policy (8)
//! ```
//!
//! The numbers are little-endian. `policy` is a digest of the policy's tagged encoding. A manifest of the third format
//! ("EFM" 3) differs by its magic and by the digest, which is of a text with the code's names in it. It is read still: one
//! that holds that digest of the policy in force is current, and replaced by one of the fourth format.

use uuid::Uuid;

use super::policy::Policy;
use crate::store::api::Error;
use crate::store::backend::manifests::Manifests;
use crate::store::checksum::{seal, sealed};

const MAGIC: [u8; 4] = *b"EFM\x04";
/// The magic of the third format.
const LEGACY_MAGIC: [u8; 4] = *b"EFM\x03";
const LENGTH: usize = 56;

/// What the manifest says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct Manifest {
    pub(in crate::store) journal: Uuid,
    /// Number of the generation that is served.
    pub(in crate::store) generation: u64,
    /// The last control it was made under; 0 for none.
    pub(in crate::store) applied: u64,
    /// See [`crate::store::api::MapStore::lineage`].
    pub(in crate::store) lineage: u64,
    /// See [`crate::store::map::policy::Policy::digest`].
    pub(in crate::store) policy: u64,
}

/// What there is in the manifest's place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) enum Found {
    None,
    Sound(Manifest),
    /// Or something else than a manifest.
    Damaged,
}

impl Manifest {
    /// The newest manifest. One of the third format that was made under the policy in force is brought into
    /// the fourth first.
    ///
    /// # Errors
    /// When it cannot be read, or that cannot be written.
    pub(in crate::store) fn read(manifests: &dyn Manifests, policy: &Policy) -> Result<Found, Error> {
        let Some(bytes) = manifests.newest()? else { return Ok(Found::None) };
        if let Some(manifest) = Self::parse(&bytes, MAGIC) {
            return Ok(Found::Sound(manifest));
        }
        let Some(legacy) = Self::parse(&bytes, LEGACY_MAGIC) else { return Ok(Found::Damaged) };
        if legacy.policy != policy.legacy_digest() {
            return Ok(Found::Sound(legacy));
        }
        let manifest = Self { policy: policy.digest(), ..legacy };
        manifest.write(manifests)?;
        tracing::info!("the manifest was brought into the present format");
        Ok(Found::Sound(manifest))
    }

    /// Makes it the newest manifest: it is durable, whole, when this returns.
    ///
    /// # Errors
    /// When another server took over, or it cannot be written.
    pub(in crate::store) fn write(&self, manifests: &dyn Manifests) -> Result<(), Error> {
        manifests.publish(&self.bytes(MAGIC))
    }

    fn bytes(&self, magic: [u8; 4]) -> [u8; LENGTH] {
        let mut bytes = [0; LENGTH];
        bytes[..4].copy_from_slice(&magic);
        bytes[8..24].copy_from_slice(self.journal.as_bytes());
        bytes[24..32].copy_from_slice(&self.generation.to_le_bytes());
        bytes[32..40].copy_from_slice(&self.applied.to_le_bytes());
        bytes[40..48].copy_from_slice(&self.lineage.to_le_bytes());
        bytes[48..].copy_from_slice(&self.policy.to_le_bytes());
        seal(&mut bytes[4..], &[]);
        bytes
    }

    fn parse(bytes: &[u8], magic: [u8; 4]) -> Option<Self> {
        let bytes: &[u8; LENGTH] = bytes.try_into().ok()?;
        sealed(&bytes[4..], &[])?;
        if bytes[..4] != magic {
            return None;
        }
        let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        let journal = Uuid::from_slice(&bytes[8..24]).ok()?;
        let (generation, applied, lineage, policy) = (word(24), word(32), word(40), word(48));
        Some(Self { journal, generation, applied, lineage, policy })
    }
}

/// The bytes that a manifest had in the third format, for tests.
#[cfg(test)]
pub(in crate::store) fn legacy(bytes: &[u8], policy: &Policy) -> Vec<u8> {
    let manifest = Manifest::parse(bytes, MAGIC).expect("tests give a sound one");
    assert_eq!(manifest.policy, policy.digest());
    Manifest { policy: policy.legacy_digest(), ..manifest }.bytes(LEGACY_MAGIC).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::backend::memory::Memory;

    #[test]
    fn a_manifest_is_read_whole_or_not_at_all() {
        let manifests = &*Memory::default().open().manifests;
        let policy = Policy::trusting();
        assert_eq!(Manifest::read(manifests, &policy).unwrap(), Found::None);
        let journal = Uuid::from_u128(3);
        let manifest = Manifest { journal, generation: 4, applied: 9, lineage: 11, policy: 12 };
        manifest.write(manifests).unwrap();
        assert_eq!(Manifest::read(manifests, &policy).unwrap(), Found::Sound(manifest));
        let good = manifests.newest().unwrap().unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 32;
            manifests.publish(&bad).unwrap();
            assert_eq!(Manifest::read(manifests, &policy).unwrap(), Found::Damaged, "byte {at}");
            manifests.publish(&good[..at]).unwrap();
            assert_eq!(Manifest::read(manifests, &policy).unwrap(), Found::Damaged, "cut at {at}");
        }
    }

    /// The bytes of either format, as they lie on disk.
    #[test]
    fn the_formats_stay_as_they_are() {
        let journal = Uuid::from_u128(3);
        let manifest = Manifest { journal, generation: 4, applied: 9, lineage: 11, policy: 12 };
        let rest = [
            vec![0; 15],
            vec![
                3, 4, 0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 11, 0, 0, 0, 0, 0, 0, 0, 12, 0, 0, 0, 0,
                0, 0, 0,
            ],
        ]
        .concat();
        let sum = crc32c::crc32c(&rest).to_le_bytes();
        for magic in [b"EFM\x04", b"EFM\x03"] {
            assert_eq!(manifest.bytes(*magic).to_vec(), [&magic[..], &sum, &rest].concat());
        }
    }

    /// Catches: an update of the service that folds every map anew, or that takes any old manifest for current.
    #[test]
    fn a_manifest_of_the_third_format_is_current_under_its_own_policy_only() {
        let manifests = &*Memory::default().open().manifests;
        let policy = Policy::trusting();
        let other = Policy { publish_contributors: 2, ..policy };
        let journal = Uuid::from_u128(3);
        // Hard-coded: what a service of that time wrote.
        let legacy = Manifest { journal, generation: 4, applied: 9, lineage: 11, policy: LEGACY_TRUSTING };
        manifests.publish(&legacy.bytes(LEGACY_MAGIC)).unwrap();
        assert_eq!(Manifest::read(manifests, &other).unwrap(), Found::Sound(legacy));
        let bytes = manifests.newest().unwrap().unwrap();
        assert_eq!(bytes[..4], LEGACY_MAGIC, "under another policy it stays");
        let current = Manifest { policy: policy.digest(), ..legacy };
        assert_eq!(Manifest::read(manifests, &policy).unwrap(), Found::Sound(current));
        let bytes = manifests.newest().unwrap().unwrap();
        assert_eq!(Manifest::parse(&bytes, MAGIC), Some(current), "it is rewritten");
    }

    /// See the test of the policy's legacy text.
    const LEGACY_TRUSTING: u64 = 0xeb2c_e15a_4937_d92e;
}
