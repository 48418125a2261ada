//! What every object begins with.
//!
//! ```text
//! magic with a version (4) | CRC-32C of the rest (4) | content
//! ```

use crate::store::checksum::{SUM, seal, sealed};

/// The bytes of an object.
pub(in crate::store) fn wrap(magic: [u8; 4], content: &[u8]) -> Vec<u8> {
    let mut bytes = [&magic[..], &[0; SUM], content].concat();
    seal(&mut bytes[4..], &magic);
    bytes
}

/// The content of an object; `None` when it is none of this kind, or damaged.
pub(in crate::store) fn unwrap(magic: [u8; 4], bytes: &[u8]) -> Option<&[u8]> {
    let rest = bytes.strip_prefix(&magic)?;
    sealed(rest, &magic)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_changed_byte_is_noticed() {
        let bytes = wrap(*b"EFA\x01", b"content");
        assert_eq!(unwrap(*b"EFA\x01", &bytes), Some(&b"content"[..]));
        for at in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[at] ^= 1;
            assert_eq!(unwrap(*b"EFA\x01", &bad), None);
            assert_eq!(unwrap(*b"EFA\x01", &bytes[..at]), None);
        }
    }
}
