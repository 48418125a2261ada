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
use crate::columns::ColumnReader;
use crate::geo::{TileId, Zone};
use crate::sealed::{self, SealedFormat};
use crate::tile::{CELLS, DecodeError};
use crate::varint::{VarintReader, VarintWriter, Varints};

const FORMAT: SealedFormat = SealedFormat { magic: *b"EFC", version: 2 };
/// Read and written once each, and many of them: speed matters more than the last bytes.
const ZSTD_LEVEL: i32 = 1;
/// Bytes of a tile in the header, at least: EPSG codes of UTM take three, all else one.
const LEAST_TILE: usize = 6;
/// Bytes of a cell in the columns, at least and at most.
const LEAST_CELL: usize = 4;
const MOST_CELL: usize = 21;
/// Bytes of a tile's blocks in view, at most.
const MOST_BLOCKS: usize = 2 * (VIEW_BLOCKS + 2);

/// How much an evidence delta may hold. It is held against the header before any cell is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeltaLimits {
    /// Tiles.
    pub tiles: usize,
    /// Cells of all tiles: a little more than 16 bytes of memory each.
    pub cells: usize,
}

impl DeltaLimits {
    /// Bytes of the columns of so many cells and tiles, at most.
    fn columns(self) -> usize {
        let DeltaLimits { tiles, cells } = self;
        cells.saturating_mul(MOST_CELL).saturating_add(tiles.saturating_mul(MOST_BLOCKS))
    }
}

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
/// about 4 of them, and 21 at most. For bytes that were checked when they came; see [`decode_within`].
///
/// # Errors
/// When the bytes are not an evidence delta's, are damaged, or break the format.
pub fn decode(bytes: &[u8], most: usize) -> Result<EvidenceDelta, DecodeError> {
    let mut input = VarintReader { rest: FORMAT.unseal(bytes)? };
    let head = header(&mut input).ok_or(DecodeError::Malformed)?;
    delta(&head, &mut input, most).ok_or(DecodeError::Malformed)
}

/// The evidence delta of a stranger's bytes: one that holds more than allowed is refused by its header.
///
/// # Errors
/// When the bytes are not an evidence delta's, are damaged, break the format, or hold too much.
pub fn decode_within(bytes: &[u8], limits: DeltaLimits) -> Result<EvidenceDelta, DecodeError> {
    let mut input = VarintReader { rest: FORMAT.unseal(bytes)? };
    // Before the tiles themselves are read, of which there may be hundreds of thousands.
    let tiles = tile_count(&mut VarintReader { ..input }).ok_or(DecodeError::Malformed)?;
    if tiles > limits.tiles {
        return Err(DecodeError::TooManyTiles { found: tiles, most: limits.tiles });
    }
    let head = header(&mut input).ok_or(DecodeError::Malformed)?;
    let cells = head.tiles.iter().map(|(_, cells)| *cells).sum();
    if cells > limits.cells {
        return Err(DecodeError::TooManyCells { found: cells, most: limits.cells });
    }
    delta(&head, &mut input, limits.columns()).ok_or(DecodeError::Malformed)
}

/// The number of tiles; what comes before it is skipped.
fn tile_count(input: &mut VarintReader<'_>) -> Option<usize> {
    input.value()?;
    input.count_of(LEAST_TILE)
}

fn header(input: &mut VarintReader<'_>) -> Option<DeltaHeader> {
    let detections = input.get()?;
    let count = input.count_of(LEAST_TILE)?;
    let mut tiles = Vec::with_capacity(count);
    for _ in 0..count {
        tiles.push(tile(input)?);
    }
    tiles.is_sorted_by(|a, b| a.0 < b.0).then_some(DeltaHeader { detections, tiles })
}

fn tile(input: &mut VarintReader<'_>) -> Option<(TileId, usize)> {
    let zone = Zone::from_epsg(input.get()?).ok()?;
    let (x, y) = (input.get_signed()?, input.get_signed()?);
    let cells = input.get().filter(|cells| *cells <= CELLS as usize)?;
    Some((TileId { zone, y, x }, cells))
}

fn delta(head: &DeltaHeader, input: &mut VarintReader<'_>, most: usize) -> Option<EvidenceDelta> {
    let length = input.get().filter(|length| *length <= most)?;
    let mut columns = ColumnReader::new(input.rest, length)?;
    let tiles = tile_evidence(&head.tiles, &mut columns)?;
    columns.finish()?;
    Some(EvidenceDelta { tiles, detections: head.detections })
}

fn tile_evidence(
    tiles: &[(TileId, usize)],
    input: &mut impl Varints,
) -> Option<BTreeMap<TileId, TileEvidence>> {
    let counts = || tiles.iter().map(|(_, count)| *count);
    // No room is made for cells that cannot be in the columns.
    if counts().sum::<usize>() > input.room() / LEAST_CELL {
        return None;
    }
    let observed: Vec<_> = tiles.iter().map(|_| blocks(input)).collect::<Option<_>>()?;
    let mut cells = blank_cells(counts(), input)?;
    for cell in cells.iter_mut().flatten() {
        cell.hits = input.get().filter(|hits| *hits > 0)?;
    }
    for axis in [0, 1] {
        for cell in cells.iter_mut().flatten() {
            let most = u64::from(cell.hits) * u64::from(OFFSET_STEPS);
            let sum = input.get_signed::<i64>()?.checked_add(middle(cell.hits))?;
            cell.offset_sum[axis] = u32::try_from(sum).ok().filter(|sum| u64::from(*sum) <= most)?;
        }
    }
    let evidence = cells.into_iter().zip(observed).map(|(cells, observed)| TileEvidence { cells, observed });
    Some(tiles.iter().map(|(id, _)| *id).zip(evidence).collect())
}

/// The cells of all tiles, by their indices alone. Cells take room only once all indices have been read.
fn blank_cells(
    counts: impl Iterator<Item = usize> + Clone,
    input: &mut impl Varints,
) -> Option<Vec<Vec<CellHits>>> {
    let mut indices = Vec::new();
    for count in counts.clone() {
        input.ascending(count, CELLS, &mut indices)?;
    }
    let blank = |index| CellHits { index, hits: 0, offset_sum: [0, 0] };
    let mut rest = indices.into_iter();
    Some(counts.map(|count| rest.by_ref().take(count).map(blank).collect()).collect())
}

/// Blocks as the number of their runs and the runs' lengths.
pub(crate) fn put_blocks(out: &mut VarintWriter, blocks: &ViewBlocks) {
    let runs = blocks.runs();
    out.put(runs.len() as u64);
    out.put_all(runs.into_iter().map(|run| run as u64));
}

/// What [`put_blocks`] wrote.
pub(crate) fn blocks(input: &mut impl Varints) -> Option<ViewBlocks> {
    let count = input.count_of(1).filter(|count| *count <= VIEW_BLOCKS + 1)?;
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
