//! The bytes of a tile and of a ledger.
//!
//! ```text
//! magic "EFT" or "EFL" | format version (1 byte) | CRC-32C of all that follows (4 bytes, LE) | zstd frame
//! ```
//!
//! The frame holds LEB128 varints, one column after the other: a column's values resemble each
//! other, so they pack better together than cell by cell. Indices are stored as distances.

use std::collections::BTreeSet;

use super::{CELLS, Ledger, Tile};
use crate::evidence::{Cell, OFFSET_STEPS, Pass};

const TILE_MAGIC: [u8; 4] = *b"EFT\x01";
const LEDGER_MAGIC: [u8; 4] = *b"EFL\x01";
const HEADER: usize = 8;
const ZSTD_LEVEL: i32 = 3;
/// A full tile's columns stay below this; anything larger is not ours.
const MAX_DECODED: usize = 16 << 20;

/// Why bytes are not a tile or a ledger.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Too short, or it does not start as it should.
    #[error("these bytes are not of this kind, or of a newer format version")]
    NotOurs,
    /// The checksum does not match.
    #[error("the checksum does not match: the bytes are damaged")]
    Checksum,
    /// The content does not follow the format.
    #[error("the content does not follow the format")]
    Malformed,
}

/// The bytes of a tile.
#[must_use]
pub fn encode(tile: &Tile) -> Vec<u8> {
    let cells = &tile.cells;
    let base_day = cells.iter().map(|(_, c)| c.first_day).min().unwrap_or(0);
    let mut out = Writer::default();
    out.put(cells.len() as u64);
    out.put(u64::from(base_day));
    out.put_ascending(cells.iter().map(|(index, _)| *index));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.hits)));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.passes)));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.first_day - base_day)));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.last_day - c.first_day)));
    for axis in [0, 1] {
        out.put_all(cells.iter().map(|(_, c)| u64::from(c.offset_sum[axis])));
    }
    out.seal(TILE_MAGIC)
}

/// The tile of its bytes.
///
/// # Errors
/// When the bytes are not a tile's, are damaged, or break the format.
pub fn decode(bytes: &[u8]) -> Result<Tile, DecodeError> {
    let body = unseal(bytes, TILE_MAGIC)?;
    let mut input = Reader { rest: &body };
    let count = input.count(CELLS)?;
    let base_day: u16 = input.get()?;
    let index = input.ascending(count)?;
    let mut cells = vec![Cell::default(); count];
    for cell in &mut cells {
        cell.hits = input.get()?;
    }
    for cell in &mut cells {
        cell.passes = input.get()?;
    }
    for cell in &mut cells {
        cell.first_day = base_day.checked_add(input.get()?).ok_or(DecodeError::Malformed)?;
    }
    for cell in &mut cells {
        cell.last_day = cell.first_day.checked_add(input.get()?).ok_or(DecodeError::Malformed)?;
    }
    for axis in [0, 1] {
        for cell in &mut cells {
            cell.offset_sum[axis] = input.get()?;
            if u64::from(cell.offset_sum[axis]) > u64::from(cell.hits) * u64::from(OFFSET_STEPS) {
                return Err(DecodeError::Malformed);
            }
        }
    }
    input.finish()?;
    Tile::from_cells(index.into_iter().zip(cells).collect()).ok_or(DecodeError::Malformed)
}

/// The bytes of a ledger.
#[must_use]
pub fn encode_ledger(ledger: &Ledger) -> Vec<u8> {
    let mut out = Writer::default();
    out.put(ledger.iter().count() as u64);
    for (pass, cells) in ledger.iter() {
        out.put(u64::from(pass.day));
        out.put(pass.contributor);
        out.put(cells.len() as u64);
        out.put_ascending(cells.iter().copied());
    }
    out.seal(LEDGER_MAGIC)
}

/// The ledger of its bytes.
///
/// # Errors
/// When the bytes are not a ledger's, are damaged, or break the format.
pub fn decode_ledger(bytes: &[u8]) -> Result<Ledger, DecodeError> {
    let body = unseal(bytes, LEDGER_MAGIC)?;
    let mut input = Reader { rest: &body };
    let passes = input.count(u32::MAX)?;
    let mut votes: Vec<(Pass, BTreeSet<u32>)> = Vec::new();
    for _ in 0..passes {
        let pass = Pass { day: input.get()?, contributor: input.get()? };
        let count = input.count(CELLS)?;
        votes.push((pass, input.ascending(count)?.into_iter().collect()));
    }
    input.finish()?;
    Ok(votes.into_iter().collect())
}

#[derive(Default)]
struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    fn put(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    fn put_all(&mut self, values: impl Iterator<Item = u64>) {
        values.for_each(|value| self.put(value));
    }

    /// Strictly increasing values, as the distance from the one before (the first from -1), less 1.
    fn put_ascending(&mut self, values: impl Iterator<Item = u32>) {
        let mut next = 0;
        for value in values {
            self.put(u64::from(value - next));
            next = value + 1;
        }
    }

    fn seal(self, magic: [u8; 4]) -> Vec<u8> {
        let frame = zstd::bulk::compress(&self.bytes, ZSTD_LEVEL)
            .expect("compressing into a buffer of the library's own bound cannot fail");
        let mut out = Vec::with_capacity(HEADER + frame.len());
        out.extend_from_slice(&magic);
        out.extend_from_slice(&crc32c::crc32c(&frame).to_le_bytes());
        out.extend_from_slice(&frame);
        out
    }
}

fn unseal(bytes: &[u8], magic: [u8; 4]) -> Result<Vec<u8>, DecodeError> {
    let (head, rest) = bytes.split_first_chunk::<4>().ok_or(DecodeError::NotOurs)?;
    let (sum, frame) = rest.split_first_chunk::<4>().ok_or(DecodeError::NotOurs)?;
    if *head != magic {
        return Err(DecodeError::NotOurs);
    }
    if crc32c::crc32c(frame) != u32::from_le_bytes(*sum) {
        return Err(DecodeError::Checksum);
    }
    zstd::bulk::decompress(frame, MAX_DECODED).map_err(|_| DecodeError::Malformed)
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl Reader<'_> {
    fn varint(&mut self) -> Result<u64, DecodeError> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let (byte, rest) = self.rest.split_first().ok_or(DecodeError::Malformed)?;
            self.rest = rest;
            let bits = u64::from(byte & 0x7f);
            if (bits << shift) >> shift != bits {
                return Err(DecodeError::Malformed);
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(DecodeError::Malformed)
    }

    fn get<T: TryFrom<u64>>(&mut self) -> Result<T, DecodeError> {
        T::try_from(self.varint()?).map_err(|_| DecodeError::Malformed)
    }

    /// A count that must not exceed `most`, nor what the remaining bytes could hold.
    fn count(&mut self, most: u32) -> Result<usize, DecodeError> {
        let count: u32 = self.get()?;
        if count > most || count as usize > self.rest.len() {
            Err(DecodeError::Malformed)
        } else {
            Ok(count as usize)
        }
    }

    fn ascending(&mut self, count: usize) -> Result<Vec<u32>, DecodeError> {
        let mut next = 0_u32;
        (0..count)
            .map(|_| {
                let value =
                    next.checked_add(self.get()?).filter(|v| *v < CELLS).ok_or(DecodeError::Malformed)?;
                next = value + 1;
                Ok(value)
            })
            .collect()
    }

    fn finish(&self) -> Result<(), DecodeError> {
        if self.rest.is_empty() { Ok(()) } else { Err(DecodeError::Malformed) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::uploads;
    use super::*;
    use proptest::prelude::*;

    fn folded(uploads: &[(Pass, Vec<crate::evidence::CellHits>)]) -> (Tile, Ledger) {
        let (mut tile, mut ledger) = (Tile::default(), Ledger::default());
        for (pass, hits) in uploads {
            tile.fold(&mut ledger, *pass, hits);
        }
        (tile, ledger)
    }

    proptest! {
        #[test]
        fn decoding_undoes_encoding(uploads in uploads()) {
            let (tile, ledger) = folded(&uploads);
            prop_assert_eq!(decode(&encode(&tile)), Ok(tile));
            prop_assert_eq!(decode_ledger(&encode_ledger(&ledger)), Ok(ledger));
        }

        #[test]
        fn a_flipped_bit_is_noticed(uploads in uploads(), at in any::<prop::sample::Index>(), bit in 0..8_u8) {
            let mut bytes = encode(&folded(&uploads).0);
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
            prop_assert!(decode(&bytes).is_err());
        }

        #[test]
        fn garbage_is_refused_without_panic(mut body in prop::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(decode(&body).is_err());
            // Past the checksum, too.
            let sealed = Writer { bytes: std::mem::take(&mut body) }.seal(TILE_MAGIC);
            let _ = decode(&sealed);
            let sealed = Writer { bytes: sealed }.seal(LEDGER_MAGIC);
            let _ = decode_ledger(&sealed);
        }
    }

    #[test]
    fn truncation_and_foreign_kinds_are_refused() {
        let bytes = encode(&Tile::from_cells(vec![(3, Cell { hits: 1, ..Cell::default() })]).unwrap());
        for end in 0..bytes.len() {
            assert!(decode(&bytes[..end]).is_err(), "{end}");
        }
        assert_eq!(decode_ledger(&bytes), Err(DecodeError::NotOurs));
    }

    #[test]
    fn an_empty_tile_has_an_encoding() {
        assert_eq!(decode(&encode(&Tile::default())), Ok(Tile::default()));
    }
}
