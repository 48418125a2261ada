//! The bytes of a segment file.
//!
//! ```text
//! header   magic "EFJ" 1 (4) | CRC-32C of the rest of the header (4) | first number (8) | journal id (16)
//! record   length (4) | CRC-32C of all but itself (4) | number (8) | synced (8) | payload
//! ```
//!
//! All little-endian. Records are numbered from 1 without a gap over all segments; a file is named
//! by the number of its first record. `synced` is the last number that was on disk when the record
//! was written: damage before it cannot be a torn write, see [`crate::store::log::recover`].

use uuid::Uuid;

use crate::store::backend::segments::HEADER;
use crate::store::checksum::{seal, sealed};

const MAGIC: [u8; 4] = *b"EFJ\x01";
/// Bytes of a record's length, which precedes its checksummed frame.
const LENGTH: usize = 4;
/// Bytes of a record before its payload.
pub(super) const RECORD_HEADER: usize = 24;

/// The bytes of a header.
pub(in crate::store) fn header(journal: Uuid, first: u64) -> [u8; HEADER] {
    let mut bytes = [0; HEADER];
    bytes[..4].copy_from_slice(&MAGIC);
    bytes[8..16].copy_from_slice(&first.to_le_bytes());
    bytes[16..].copy_from_slice(journal.as_bytes());
    seal(&mut bytes[4..], &[]);
    bytes
}

/// Journal id and first number of a sound header.
pub(super) fn parse_header(bytes: &[u8]) -> Option<(Uuid, u64)> {
    let bytes: &[u8; HEADER] = bytes.first_chunk()?;
    let (first, journal) = (u64_at(bytes, 8)?, Uuid::from_slice(&bytes[16..]).ok()?);
    (header(journal, first) == *bytes).then_some((journal, first))
}

/// Appends a record.
pub(super) fn put_record(out: &mut Vec<u8>, number: u64, synced: u64, payload: &[u8]) {
    let start = out.len();
    out.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    out.extend_from_slice(&[0; 4]);
    out.extend_from_slice(&number.to_le_bytes());
    out.extend_from_slice(&synced.to_le_bytes());
    out.extend_from_slice(payload);
    let (length, frame) = out[start..].split_at_mut(LENGTH);
    seal(frame, length);
}

/// A record as it is on disk.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct FramedRecord<'a> {
    pub(in crate::store) number: u64,
    pub(in crate::store) synced: u64,
    pub(in crate::store) payload: &'a [u8],
}

impl FramedRecord<'_> {
    /// Bytes on disk.
    pub(in crate::store) fn len(&self) -> usize {
        RECORD_HEADER + self.payload.len()
    }
}

/// The record at the start of the bytes; `None` when it is cut short or damaged.
pub(super) fn parse_record(bytes: &[u8]) -> Option<FramedRecord<'_>> {
    let length = u32_at(bytes, 0)? as usize;
    let record = bytes.get(..RECORD_HEADER.checked_add(length)?)?;
    let (length, frame) = record.split_at_checked(LENGTH)?;
    let rest = sealed(frame, length)?;
    Some(FramedRecord { number: u64_at(rest, 0)?, synced: u64_at(rest, 8)?, payload: &rest[16..] })
}

/// The number a record at the start of the bytes would have, unchecked.
pub(super) fn peek_number(bytes: &[u8]) -> Option<u64> {
    u64_at(bytes, 8)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_changed_bit_of_a_record_is_noticed(payload: Vec<u8>, at: prop::sample::Index, bit in 0..8_u8) {
            let mut bytes = Vec::new();
            put_record(&mut bytes, 7, 6, &payload);
            prop_assert_eq!(
                parse_record(&bytes), Some(FramedRecord { number: 7, synced: 6, payload: &payload })
            );
            let at = at.index(bytes.len());
            prop_assert_eq!(parse_record(&bytes[..at]), None);
            bytes[at] ^= 1_u8 << bit;
            prop_assert_eq!(parse_record(&bytes), None);
        }
    }

    #[test]
    fn headers_are_checked() {
        let id = Uuid::from_u128(5);
        let good = header(id, 9);
        assert_eq!(parse_header(&good), Some((id, 9)));
        for at in 0..HEADER {
            let mut bad = good;
            bad[at] ^= 4;
            assert_eq!(parse_header(&bad), None, "{at}");
            assert_eq!(parse_header(&good[..at]), None);
        }
    }
}
