//! The bytes of a segment of the shared journal.
//!
//! ```text
//! header   magic "EFL" 1 (4) | CRC-32C of the rest of the header (4) | cluster (16) | writer (16) | seq (8) |
//!          number of the first record (8) | records (4) | CRC-32C of all records (4)
//! record   length (4) | bytes, as `log::entry` has them
//! ```
//!
//! All little-endian. The header has a checksum of its own, so that segments are found by it alone.

use uuid::Uuid;

use crate::store::checksum::{seal, sealed};

const MAGIC: [u8; 4] = *b"EFL\x01";
/// Bytes of a header.
pub(in crate::store) const HEADER: usize = 64;

/// What a segment's header says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct Header {
    /// Whose journal it is of.
    pub(in crate::store) cluster: Uuid,
    /// The opening of a server that wrote it.
    pub(in crate::store) writer: Uuid,
    /// Its own number.
    pub(in crate::store) seq: u64,
    /// Number of its first record.
    pub(in crate::store) first: u64,
    /// Its records.
    pub(in crate::store) records: u32,
    sum: u32,
}

impl Header {
    /// Number of the first record behind it.
    pub(in crate::store) fn end(&self) -> u64 {
        self.first + u64::from(self.records)
    }

    /// The header of a segment; `None` when it is none, or damaged.
    pub(in crate::store) fn parse(bytes: &[u8]) -> Option<Self> {
        let rest = sealed(bytes.get(..HEADER)?.strip_prefix(&MAGIC)?, &MAGIC)?;
        let id = |at: usize| Uuid::from_slice(&rest[at..at + 16]).ok();
        let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| rest[at + i]));
        let half = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| rest[at + i]));
        let (seq, first, records, sum) = (word(32), word(40), half(48), half(52));
        first.checked_add(u64::from(records))?;
        Some(Self { cluster: id(0)?, writer: id(16)?, seq, first, records, sum })
    }
}

/// The bytes of a segment.
pub(in crate::store) fn encode(
    cluster: Uuid,
    writer: Uuid,
    (seq, first): (u64, u64),
    records: &[Vec<u8>],
) -> Vec<u8> {
    let mut bytes = vec![0; HEADER];
    bytes[..4].copy_from_slice(&MAGIC);
    bytes[8..24].copy_from_slice(cluster.as_bytes());
    bytes[24..40].copy_from_slice(writer.as_bytes());
    bytes[40..48].copy_from_slice(&seq.to_le_bytes());
    bytes[48..56].copy_from_slice(&first.to_le_bytes());
    bytes[56..60].copy_from_slice(&(records.len() as u32).to_le_bytes());
    for record in records {
        bytes.extend_from_slice(&(record.len() as u32).to_le_bytes());
        bytes.extend_from_slice(record);
    }
    let sum = crc32c::crc32c(&bytes[HEADER..]);
    bytes[60..64].copy_from_slice(&sum.to_le_bytes());
    seal(&mut bytes[4..HEADER], &MAGIC);
    bytes
}

/// The header and the records of a segment; `None` when any of it is damaged.
pub(in crate::store) fn decode(bytes: &[u8]) -> Option<(Header, Vec<Vec<u8>>)> {
    let header = Header::parse(bytes)?;
    let mut rest = &bytes[HEADER..];
    if crc32c::crc32c(rest) != header.sum {
        return None;
    }
    let mut records = Vec::new();
    while let Some((length, behind)) = rest.split_first_chunk::<4>() {
        let (record, behind) = behind.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        records.push(record.to_vec());
        rest = behind;
    }
    (rest.is_empty() && records.len() == header.records as usize).then_some((header, records))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_segment_is_read_whole_or_not_at_all(records: Vec<Vec<u8>>, at: prop::sample::Index, bit in 0..8_u8) {
            let (cluster, writer) = (Uuid::from_u128(1), Uuid::from_u128(2));
            let bytes = encode(cluster, writer, (3, 40), &records);
            let (header, read) = decode(&bytes).unwrap();
            prop_assert_eq!((header.cluster, header.writer, header.seq, header.first), (cluster, writer, 3, 40));
            prop_assert_eq!(header.end(), 40 + records.len() as u64);
            prop_assert_eq!(read, records);
            let at = at.index(bytes.len());
            prop_assert!(decode(&bytes[..at]).is_none());
            let mut bad = bytes;
            bad[at] ^= 1 << bit;
            prop_assert!(decode(&bad).is_none());
        }
    }
}
