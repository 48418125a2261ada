//! The bytes of a log file.
//!
//! ```text
//! header  magic "EFT" 1 (4) | CRC-32C of the rest of the header (4) | number of the file (8) | journal id (16)
//! frame   length of the entries (4) | CRC-32C of file number, place in the file and entries (4) | entries
//! entry   length of the key (4) | length of the value (4) | key | value
//! ```
//!
//! All little-endian. A frame counts as a whole or not at all.

use std::ops::Range;

use uuid::Uuid;

const MAGIC: [u8; 4] = *b"EFT\x01";
/// Bytes of a file's header.
pub(super) const HEADER: usize = 32;
const FRAME_HEADER: usize = 8;
const ENTRY_HEADER: usize = 8;

/// Key and value.
pub(in crate::store) type Entry = (Vec<u8>, Vec<u8>);

/// The bytes of a header.
pub(super) fn header(journal: Uuid, number: u64) -> [u8; HEADER] {
    let mut bytes = [0; HEADER];
    bytes[..4].copy_from_slice(&MAGIC);
    bytes[8..16].copy_from_slice(&number.to_le_bytes());
    bytes[16..].copy_from_slice(journal.as_bytes());
    let checksum = crc32c::crc32c(&bytes[8..]);
    bytes[4..8].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

/// Bytes that an entry takes in a frame.
pub(super) fn size(key: &[u8], value: u32) -> u64 {
    (ENTRY_HEADER + key.len()) as u64 + u64::from(value)
}

/// A frame at a place of a file; `None` when it would be larger than 4 GiB. Returns where in the file each value
/// begins, too.
pub(super) fn encode(number: u64, at: u64, entries: &[Entry]) -> Option<(Vec<u8>, Vec<u64>)> {
    let length: usize = entries.iter().map(|(key, value)| ENTRY_HEADER + key.len() + value.len()).sum();
    let mut bytes = Vec::with_capacity(FRAME_HEADER + length);
    bytes.extend_from_slice(&u32::try_from(length).ok()?.to_le_bytes());
    bytes.extend_from_slice(&[0; 4]);
    let mut values = Vec::with_capacity(entries.len());
    for (key, value) in entries {
        bytes.extend_from_slice(&(key.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&(value.len() as u32).to_le_bytes());
        bytes.extend_from_slice(key);
        values.push(at + bytes.len() as u64);
        bytes.extend_from_slice(value);
    }
    let checksum = checksum(number, at, &bytes[FRAME_HEADER..]);
    bytes[4..8].copy_from_slice(&checksum.to_le_bytes());
    Some((bytes, values))
}

/// An entry of a file: its key, and which bytes of the file are its value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Found<'a> {
    pub(super) key: &'a [u8],
    pub(super) value: Range<usize>,
}

/// The entries of a file's frames up to the first that is cut short or damaged, and where that is: the file's
/// length when all are sound.
pub(super) fn walk(number: u64, file: &[u8]) -> (Vec<Found<'_>>, usize) {
    let (mut found, mut at) = (Vec::new(), HEADER);
    while let Some((entries, end)) = frame(number, file, at) {
        found.extend(entries);
        at = end;
    }
    (found, at)
}

fn frame(number: u64, file: &[u8], at: usize) -> Option<(Vec<Found<'_>>, usize)> {
    let begin = at + FRAME_HEADER;
    let end = begin.checked_add(u32_at(file, at)? as usize)?;
    let entries = file.get(begin..end)?;
    if checksum(number, at as u64, entries) != u32_at(file, at + 4)? {
        return None;
    }
    let (mut found, mut at) = (Vec::new(), begin);
    while at < end {
        let key = at + ENTRY_HEADER..(at + ENTRY_HEADER).checked_add(u32_at(file, at)? as usize)?;
        let value = key.end..key.end.checked_add(u32_at(file, at + 4)? as usize)?;
        at = value.end;
        found.push(Found { key: file.get(key)?, value });
    }
    (at == end).then_some((found, end))
}

fn checksum(number: u64, at: u64, entries: &[u8]) -> u32 {
    let place = crc32c::crc32c_append(crc32c::crc32c(&number.to_le_bytes()), &at.to_le_bytes());
    crc32c::crc32c_append(place, entries)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn batches() -> impl Strategy<Value = Vec<Vec<Entry>>> {
        let entry = (prop::collection::vec(any::<u8>(), 0..12), prop::collection::vec(any::<u8>(), 0..40));
        prop::collection::vec(prop::collection::vec(entry, 1..4), 1..5)
    }

    proptest! {
        // Breaks it: a checksum without the place, so that what is left of an older frame may be read again.
        #[test]
        fn what_is_cut_or_changed_ends_the_file_before_it(
            batches in batches(), at: prop::sample::Index, bit in 0..8_u8, number in 0..9_u64,
        ) {
            let mut file = header(Uuid::nil(), number).to_vec();
            let (mut ends, mut all) = (vec![file.len()], Vec::new());
            for batch in &batches {
                let (bytes, values) = encode(number, file.len() as u64, batch).unwrap();
                file.extend(bytes);
                ends.push(file.len());
                all.extend(batch.iter().zip(values).map(|((key, value), at)| {
                    (key.clone(), at as usize..at as usize + value.len(), value.clone())
                }));
            }
            let (found, end) = walk(number, &file);
            prop_assert_eq!(end, file.len());
            let found: Vec<_> =
                found.into_iter().map(|f| (f.key.to_vec(), f.value.clone(), file[f.value].to_vec())).collect();
            prop_assert_eq!(found, all);
            prop_assert_eq!(walk(number + 1, &file).1, HEADER);

            let at = HEADER + at.index(file.len() - HEADER);
            let before = *ends.iter().rfind(|end| **end <= at).unwrap();
            prop_assert_eq!(walk(number, &file[..at]).1, before);
            let mut bad = file.clone();
            bad[at] ^= 1 << bit;
            prop_assert_eq!(walk(number, &bad).1, before);
            // A frame elsewhere than where it was written is none.
            bad.splice(HEADER..HEADER, file[HEADER..ends[1]].to_vec());
            prop_assert_eq!(walk(number, &bad).1, ends[1]);
        }
    }
}
