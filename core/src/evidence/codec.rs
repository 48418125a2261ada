//! The bytes of an evidence delta: what the journal stores of an upload.
//!
//! ```text
//! magic "EFC" | format version 2 (1 byte) | CRC-32C of all that follows (4 bytes, LE) | header | zstd frame
//! ```
//!
//! The header is readable without the cells: LEB128 varints of the detections, the number of tiles, and
//! for each its EPSG code, x, y (zigzag) and number of cells; then the decoded length of the frame.
//! The frame holds one column after the other, each over all tiles: runs of blocks in view (their number
//! and lengths), the cells' indices as distances from the one before, hits, offset sums along x, along y:
//! signed, from what they would be with all hits in the cell's middle.

use std::collections::BTreeMap;

use super::{CellHits, EvidenceDelta, OFFSET_STEPS, TileEvidence, VIEW_BLOCKS, ViewBlocks};
use crate::geo::{TileId, Zone};
use crate::sealed::{self, SealedFormat};
use crate::tile::{CELLS, DecodeError};
use crate::varint::{VarintReader, VarintWriter};

const FORMAT: SealedFormat = SealedFormat { magic: *b"EFC", version: 2 };
/// Read and written once each, and many of them: speed matters more than the last bytes.
const ZSTD_LEVEL: i32 = 1;

/// The header of an evidence delta: what can be read without its cells.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeltaHeader {
    /// See [`EvidenceDelta::detections`].
    pub detections: u64,
    /// Tiles and their numbers of cells.
    pub tiles: Vec<(TileId, usize)>,
}

/// The bytes of an evidence delta.
#[must_use]
pub fn encode(delta: &EvidenceDelta) -> Vec<u8> {
    let EvidenceDelta { tiles, detections } = delta;
    let mut out = VarintWriter::default();
    out.put(*detections);
    out.put(tiles.len() as u64);
    for (id, evidence) in tiles {
        out.put(u64::from(id.zone.epsg()));
        out.put_signed(i64::from(id.x));
        out.put_signed(i64::from(id.y));
        out.put(evidence.cells.len() as u64);
    }
    let columns = columns(tiles);
    out.put(columns.len() as u64);
    out.bytes.extend(sealed::compressed(&columns, ZSTD_LEVEL));
    FORMAT.seal(&out.bytes)
}

/// Offset sum of hits in the middle of their cell.
fn middle(hits: u32) -> i64 {
    i64::from(hits) * i64::from(OFFSET_STEPS / 2)
}

fn columns(tiles: &BTreeMap<TileId, TileEvidence>) -> Vec<u8> {
    let mut out = VarintWriter::default();
    for evidence in tiles.values() {
        put_blocks(&mut out, &evidence.observed);
    }
    for evidence in tiles.values() {
        out.put_ascending(evidence.cells.iter().map(|cell| cell.index));
    }
    let cells = || tiles.values().flat_map(|evidence| &evidence.cells);
    out.put_all(cells().map(|cell| u64::from(cell.hits)));
    for axis in [0, 1] {
        cells().for_each(|cell| out.put_signed(i64::from(cell.offset_sum[axis]) - middle(cell.hits)));
    }
    out.bytes
}

/// The header of an evidence delta's bytes; the cells are not looked at.
///
/// # Errors
/// When the bytes are not an evidence delta's, are damaged, or break the format.
pub fn decode_header(bytes: &[u8]) -> Result<DeltaHeader, DecodeError> {
    let body = FORMAT.unseal(bytes)?;
    header(&mut VarintReader { rest: body }).ok_or(DecodeError::Malformed)
}

/// The evidence delta of its bytes; columns of more than `most` bytes are refused unread. A cell takes
/// about 4 of them, and 21 at most.
///
/// # Errors
/// When the bytes are not an evidence delta's, are damaged, or break the format.
pub fn decode(bytes: &[u8], most: usize) -> Result<EvidenceDelta, DecodeError> {
    let body = FORMAT.unseal(bytes)?;
    delta(&mut VarintReader { rest: body }, most).ok_or(DecodeError::Malformed)
}

fn header(input: &mut VarintReader<'_>) -> Option<DeltaHeader> {
    let detections = input.get()?;
    let count = input.count()?;
    let tiles: Vec<_> = (0..count).map(|_| tile(input)).collect::<Option<_>>()?;
    tiles.is_sorted_by(|a, b| a.0 < b.0).then_some(DeltaHeader { detections, tiles })
}

fn tile(input: &mut VarintReader<'_>) -> Option<(TileId, usize)> {
    let zone = Zone::from_epsg(input.get()?).ok()?;
    let (x, y) = (input.get_signed()?, input.get_signed()?);
    let cells = input.get().filter(|cells| *cells <= CELLS as usize)?;
    Some((TileId { zone, y, x }, cells))
}

fn delta(input: &mut VarintReader<'_>, most: usize) -> Option<EvidenceDelta> {
    let DeltaHeader { detections, tiles } = header(input)?;
    let length = input.get().filter(|length| *length <= most)?;
    let columns = sealed::decompressed(input.rest, length)?;
    let tiles = tile_evidence(&tiles, &mut VarintReader { rest: &columns })?;
    Some(EvidenceDelta { tiles, detections })
}

fn tile_evidence(
    tiles: &[(TileId, usize)],
    input: &mut VarintReader<'_>,
) -> Option<BTreeMap<TileId, TileEvidence>> {
    let observed: Vec<_> = tiles.iter().map(|_| blocks(input)).collect::<Option<_>>()?;
    let mut cells = Vec::new();
    for (_, count) in tiles {
        let blank = |index| CellHits { index, hits: 0, offset_sum: [0, 0] };
        cells.extend(input.ascending(*count, CELLS)?.into_iter().map(blank));
    }
    for cell in &mut cells {
        cell.hits = input.get().filter(|hits| *hits > 0)?;
    }
    for axis in [0, 1] {
        for cell in &mut cells {
            let most = u64::from(cell.hits) * u64::from(OFFSET_STEPS);
            let sum = input.get_signed::<i64>()?.checked_add(middle(cell.hits))?;
            cell.offset_sum[axis] = u32::try_from(sum).ok().filter(|sum| u64::from(*sum) <= most)?;
        }
    }
    input.finish()?;
    let mut rest = cells.into_iter();
    let evidence =
        |count: usize, observed| TileEvidence { cells: rest.by_ref().take(count).collect(), observed };
    let mut evidence = evidence;
    Some(tiles.iter().zip(observed).map(|((id, count), seen)| (*id, evidence(*count, seen))).collect())
}

/// Blocks as the number of their runs and the runs' lengths.
pub(crate) fn put_blocks(out: &mut VarintWriter, blocks: &ViewBlocks) {
    let runs = blocks.runs();
    out.put(runs.len() as u64);
    out.put_all(runs.into_iter().map(|run| run as u64));
}

/// What [`put_blocks`] wrote.
pub(crate) fn blocks(input: &mut VarintReader<'_>) -> Option<ViewBlocks> {
    let count = input.count().filter(|count| *count <= VIEW_BLOCKS + 1)?;
    let runs: Vec<usize> = (0..count).map(|_| input.get()).collect::<Option<_>>()?;
    ViewBlocks::from_runs(runs.into_iter())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn contributions() -> impl Strategy<Value = EvidenceDelta> {
        let tile = (-2..3_i32, -2..3_i32, any::<bool>()).prop_map(|(x, y, south)| {
            let zone = Zone::from_epsg(if south { 32714 } else { 32614 }).unwrap();
            TileId { zone, y, x }
        });
        let cell = (1..4_u32, 0..=256_u32, 0..=256_u32);
        let cells = prop::collection::btree_map(0..CELLS, cell, 0..20).prop_map(|cells| {
            let hits = |(index, (hits, x, y))| CellHits { index, hits, offset_sum: [x, y].map(|v| hits * v) };
            cells.into_iter().map(hits).collect()
        });
        let observed = prop::collection::vec(0..VIEW_BLOCKS, 0..40);
        let evidence = (cells, observed)
            .prop_map(|(cells, observed)| TileEvidence { cells, observed: observed.into_iter().collect() });
        (prop::collection::btree_map(tile, evidence, 0..5), any::<u64>())
            .prop_map(|(tiles, detections)| EvidenceDelta { tiles, detections })
    }

    proptest! {
        #[test]
        fn decoding_undoes_encoding(delta in contributions()) {
            let bytes = encode(&delta);
            let cells: usize = delta.tiles.values().map(|evidence| evidence.cells.len()).sum();
            let head = decode_header(&bytes).unwrap();
            prop_assert_eq!(head.detections, delta.detections);
            let counted = head.tiles.iter().map(|(id, _)| *id).eq(delta.tiles.keys().copied());
            prop_assert!(counted && head.tiles.iter().map(|(_, count)| count).sum::<usize>() == cells);
            prop_assert_eq!(decode(&bytes, 1 << 20), Ok(delta));
        }

        #[test]
        fn cut_or_changed_bytes_are_refused(
            delta in contributions(), at: prop::sample::Index, flip in 1..=255_u8,
        ) {
            let mut bytes = encode(&delta);
            let at = at.index(bytes.len());
            prop_assert!(decode(&bytes[..at], 1 << 20).is_err());
            bytes[at] ^= flip;
            prop_assert!(decode(&bytes, 1 << 20).is_err());
        }

        /// Past the checksum: whoever computes it may write anything.
        #[test]
        fn forged_content_does_no_harm(
            delta in contributions(), changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        ) {
            let bytes = encode(&delta);
            let mut body = FORMAT.unseal(&bytes).unwrap().to_vec();
            for (at, value) in &changes {
                let at = at.index(body.len());
                body[at] = *value;
            }
            let _ = decode(&FORMAT.seal(&body), 1 << 20);
            let mut columns = columns(&delta.tiles);
            for (at, value) in changes.iter().filter(|_| !delta.tiles.is_empty()) {
                let at = at.index(columns.len());
                columns[at] = *value;
            }
            let tiles: Vec<_> = delta.tiles.iter().map(|(id, evidence)| (*id, evidence.cells.len())).collect();
            let _ = tile_evidence(&tiles, &mut VarintReader { rest: &columns });
        }
    }

    #[test]
    fn columns_longer_than_allowed_are_refused() {
        let cells = (0..100).map(|index| CellHits { index, hits: 1, offset_sum: [130, 126] }).collect();
        let id = TileId { zone: Zone::from_epsg(32614).unwrap(), y: 1, x: 2 };
        let delta = EvidenceDelta { tiles: [(id, TileEvidence::of_hits(cells))].into(), detections: 100 };
        let bytes = encode(&delta);
        assert_eq!(decode(&bytes, 400), Err(DecodeError::Malformed));
        assert_eq!(decode(&bytes, 500), Ok(delta));
    }
}
