//! The bytes of an upload in the journal.
//!
//! ```text
//! version 1 (1 byte) | upload id (16 bytes) | contributor hash (8 bytes, LE) | varint head | zstd frame
//! ```
//!
//! The head holds LEB128 varints: day, forget-before day, detections, the answer (length, bytes),
//! the number of tiles and for each tile its EPSG code, x, y (zigzag) and number of cells; then
//! the decoded length of the frame. The frame holds the cells of all tiles, one column after the
//! other: indices as distances from the one before, hits, offset sums along x and along y.
//! A contributor is in here as a keyed hash only, and no column says when within the day, or on
//! which way, anything was seen. The upload's id and the answer are kept as they were sent: an id
//! with a timestamp, such as a UUID of version 7, tells when it was made. A vehicle that does not want
//! that known uses ids without one.

use std::collections::BTreeMap;

use echofix_core::evidence::{CellHits, Contribution, Pass};
use echofix_core::geo::{TileId, Zone};
use echofix_core::tile::CELLS;
use uuid::Uuid;

use super::Upload;
use super::varint::{Reader, Writer};

const VERSION: u8 = 1;
const ZSTD_LEVEL: i32 = 1;
/// No upload the service accepts comes near this many bytes of cells.
const MAX_DECODED: usize = 256 << 20;

/// The bytes of an upload.
pub(super) fn encode(upload: &Upload) -> Vec<u8> {
    let Contribution { tiles, detections } = &upload.contribution;
    let mut out = Writer::default();
    out.bytes.push(VERSION);
    out.bytes.extend_from_slice(upload.id.as_bytes());
    out.bytes.extend_from_slice(&upload.pass.contributor.to_le_bytes());
    out.put(u64::from(upload.pass.day));
    out.put(u64::from(upload.forget_before));
    out.put(*detections);
    out.put_bytes(&upload.answer);
    out.put(tiles.len() as u64);
    for (id, cells) in tiles {
        out.put(u64::from(id.zone.epsg()));
        out.put_signed(i64::from(id.x));
        out.put_signed(i64::from(id.y));
        out.put(cells.len() as u64);
    }
    let columns = columns(tiles);
    out.put(columns.len() as u64);
    let frame = zstd::bulk::compress(&columns, ZSTD_LEVEL)
        .expect("compressing into a buffer of the library's own bound cannot fail");
    out.bytes.extend(frame);
    out.bytes
}

fn columns(tiles: &BTreeMap<TileId, Vec<CellHits>>) -> Vec<u8> {
    let mut out = Writer::default();
    for cells in tiles.values() {
        let mut next = 0;
        for cell in cells {
            out.put(u64::from(cell.index - next));
            next = cell.index + 1;
        }
    }
    let cells = || tiles.values().flatten();
    cells().for_each(|cell| out.put(u64::from(cell.hits)));
    for axis in [0, 1] {
        cells().for_each(|cell| out.put(u64::from(cell.offset_sum[axis])));
    }
    out.bytes
}

/// What the journal's index needs of a record, without its cells.
#[derive(Debug, PartialEq)]
pub(super) struct Head {
    pub(super) id: Uuid,
    pub(super) pass: Pass,
    pub(super) forget_before: u16,
    pub(super) answer: Vec<u8>,
    detections: u64,
    /// Tiles and their number of cells.
    pub(super) tiles: Vec<(TileId, usize)>,
}

/// The head of an upload's bytes; `None` when they do not follow the format.
pub(super) fn decode_head(bytes: &[u8]) -> Option<Head> {
    head(&mut Reader { rest: bytes })
}

fn head(input: &mut Reader<'_>) -> Option<Head> {
    if input.take(1)? != [VERSION] {
        return None;
    }
    let id = Uuid::from_slice(input.take(16)?).ok()?;
    let contributor = u64::from_le_bytes(input.take(8)?.try_into().ok()?);
    let pass = Pass { day: input.get()?, contributor };
    let forget_before = input.get()?;
    let detections = input.get()?;
    let answer = input.bytes()?.to_vec();
    let count = input.count()?;
    let tiles = (0..count).map(|_| tile(input)).collect::<Option<_>>()?;
    Some(Head { id, pass, forget_before, answer, detections, tiles })
}

fn tile(input: &mut Reader<'_>) -> Option<(TileId, usize)> {
    let zone = Zone::from_epsg(input.get()?).ok()?;
    let (x, y) = (input.get_signed()?, input.get_signed()?);
    let cells = input.get().filter(|cells| *cells <= CELLS as usize)?;
    Some((TileId { zone, y, x }, cells))
}

/// The upload of its bytes; `None` when they do not follow the format.
pub(super) fn decode(bytes: &[u8]) -> Option<Upload> {
    let mut input = Reader { rest: bytes };
    let head = head(&mut input)?;
    let length = input.get().filter(|length| *length <= MAX_DECODED)?;
    let columns = zstd::bulk::decompress(input.rest, length).ok()?;
    let tiles = cells(&head.tiles, &mut Reader { rest: &columns })?;
    let contribution = Contribution { tiles, detections: head.detections };
    let Head { id, pass, forget_before, answer, .. } = head;
    Some(Upload { id, pass, forget_before, contribution, answer })
}

fn cells(tiles: &[(TileId, usize)], input: &mut Reader<'_>) -> Option<BTreeMap<TileId, Vec<CellHits>>> {
    let all: usize = tiles.iter().map(|(_, count)| count).sum();
    if all > input.rest.len() {
        return None;
    }
    let mut cells = Vec::with_capacity(all);
    for (_, count) in tiles {
        let mut next = 0_u32;
        for _ in 0..*count {
            let index = next.checked_add(input.get()?).filter(|index| *index < CELLS)?;
            next = index + 1;
            cells.push(CellHits { index, hits: 0, offset_sum: [0, 0] });
        }
    }
    for cell in &mut cells {
        cell.hits = input.get()?;
    }
    for axis in [0, 1] {
        for cell in &mut cells {
            cell.offset_sum[axis] = input.get()?;
        }
    }
    let mut rest = cells.into_iter();
    let split = tiles.iter().map(|(id, count)| (*id, rest.by_ref().take(*count).collect())).collect();
    input.rest.is_empty().then_some(split)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::testing::uploads;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_upload_survives_its_bytes(upload in uploads()) {
            let bytes = encode(&upload);
            let head = decode_head(&bytes).unwrap();
            prop_assert_eq!(head.id, upload.id);
            prop_assert_eq!(head.tiles.len(), upload.contribution.tiles.len());
            prop_assert_eq!(decode(&bytes), Some(upload));
        }

        #[test]
        fn cut_or_changed_bytes_do_no_harm(upload in uploads(), at: prop::sample::Index, flip in 1..=255_u8) {
            let mut bytes = encode(&upload);
            let at = at.index(bytes.len());
            prop_assert_eq!(decode(&bytes[..at]), None);
            bytes[at] ^= flip;
            // The journal's checksum tells; here it must only not panic or allocate without bound.
            let _ = decode(&bytes);
        }
    }
}
