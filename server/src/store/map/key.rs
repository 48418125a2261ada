//! Keys that tiles are stored under, in the order of their ids.
//!
//! ```text
//! EPSG code (2) | y (4) | x (4), big-endian, signs flipped: neighbours sit together
//! ```

use std::hash::Hasher;

use echofix_core::geo::{TileId, Zone};
use siphasher::sip::SipHasher24;

use crate::store::api::TileInfo;

/// Bytes of a key.
pub(in crate::store) const KEY: usize = 10;

/// The key of a tile.
pub(in crate::store) fn key(id: TileId) -> [u8; KEY] {
    let ordered = |value: i32| (value as u32 ^ 1 << 31).to_be_bytes();
    let mut key = [0; KEY];
    key[..2].copy_from_slice(&id.zone.epsg().to_be_bytes());
    key[2..6].copy_from_slice(&ordered(id.y));
    key[6..].copy_from_slice(&ordered(id.x));
    key
}

/// The tile of a key.
pub(in crate::store) fn id(key: &[u8]) -> Option<TileId> {
    let key: &[u8; KEY] = key.try_into().ok()?;
    let [e0, e1, y0, y1, y2, y3, x0, x1, x2, x3] = *key;
    let unordered = |bytes: [u8; 4]| (u32::from_be_bytes(bytes) ^ 1 << 31) as i32;
    let zone = Zone::from_epsg(u32::from(u16::from_be_bytes([e0, e1]))).ok()?;
    Some(TileId { zone, y: unordered([y0, y1, y2, y3]), x: unordered([x0, x1, x2, x3]) })
}

/// What a tile's version adds to the digest of all.
pub(super) fn stamp(info: &TileInfo) -> u64 {
    let mut hasher = SipHasher24::new();
    hasher.write(&key(info.id));
    hasher.write_u64(info.version);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn keys_sort_as_ids_do(a: (i32, i32), b: (i32, i32), south: bool) {
            let zone = Zone::from_epsg(if south { 32714 } else { 32614 }).unwrap();
            let (a, b) = (TileId { zone, y: a.0, x: a.1 }, TileId { zone, y: b.0, x: b.1 });
            prop_assert_eq!(key(a).cmp(&key(b)), a.cmp(&b));
            prop_assert_eq!(id(&key(a)), Some(a));
        }
    }
}
