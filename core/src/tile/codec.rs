//! The bytes of a tile and of a ledger.
//!
//! ```text
//! magic "EFT" or "EFL" | format version 2, 3 or 4 (1 byte) | CRC-32C of all that follows (4 bytes, LE) | zstd frame
//! ```
//!
//! The frame holds LEB128 varints, one column after the other: a column's values resemble each
//! other, so they pack better together than cell by cell. Indices are stored as distances, presences
//! as what is missing from always; of blocks, only those that are not 0. The datum comes last. A tile is of version 3, or of version 4 when a pass in it
//! declared how well its poses are known: then the sums of those follow. A ledger is of version 2.

use super::ledger::MAX_VOTES;
use super::votes::EncodedVotes;
use super::{CELLS, Ledger, Tile};
use crate::columns::ColumnReader;
use crate::datum::{Datum, DeclaredSums};
use crate::evidence::presence::ALWAYS;
use crate::evidence::{Cell, OFFSET_STEPS, Pass};
pub use crate::sealed::DecodeError;
use crate::sealed::{self, SealedFormat};
use crate::varint::{VarintWriter, Varints};

const TILE: SealedFormat = SealedFormat { magic: *b"EFT", version: 3 };
const DECLARED_TILE: SealedFormat = SealedFormat { version: 4, ..TILE };
const LEDGER: SealedFormat = SealedFormat { magic: *b"EFL", version: 2 };
const ZSTD_LEVEL: i32 = 3;
/// A full tile's columns stay below this; anything larger is not ours.
const MAX_DECODED: usize = 16 << 20;
/// Columns of a cell, and so its bytes at least.
const CELL_COLUMNS: usize = 9;
/// Bytes of a pass in a ledger, at least.
const LEAST_PASS: usize = 4;

/// The bytes of a tile.
#[must_use]
pub fn encode(tile: &Tile) -> Vec<u8> {
    let cells = &tile.cells;
    let base_day = cells.iter().map(|(_, c)| c.first_day).min().unwrap_or(0);
    let mut out = VarintWriter::default();
    out.put(cells.len() as u64);
    out.put(u64::from(base_day));
    out.put_ascending(cells.iter().map(|(index, _)| *index));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.hits)));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.passes)));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.contributors)));
    out.put_all(cells.iter().map(|(_, c)| u64::from(ALWAYS - c.presence)));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.first_day - base_day)));
    out.put_all(cells.iter().map(|(_, c)| u64::from(c.last_day - c.first_day)));
    for axis in [0, 1] {
        out.put_all(cells.iter().map(|(_, c)| u64::from(c.offset_sum[axis])));
    }
    put_sparse(&mut out, &tile.observed[..]);
    put_sparse(&mut out, &tile.support[..]);
    put_datum(&mut out, &tile.datum);
    let format = if tile.datum.declared.passes > 0 { DECLARED_TILE } else { TILE };
    format.seal(&sealed::compressed(&out.bytes, ZSTD_LEVEL))
}

/// A datum; the sums of passes that declared something follow only where there are any.
pub(super) fn put_datum(out: &mut VarintWriter, datum: &Datum) {
    out.put(u64::from(datum.passes));
    for sum in [datum.shift_mm[0], datum.shift_mm[1], datum.yaw_urad] {
        out.put_signed(sum);
    }
    if datum.declared.passes > 0 {
        put_declared(out, &datum.declared);
    }
}

/// What [`put_datum`] wrote.
pub(super) fn datum(input: &mut impl Varints, has_declared: bool) -> Option<Datum> {
    let mut datum = Datum {
        passes: input.get()?,
        shift_mm: [input.get_signed()?, input.get_signed()?],
        yaw_urad: input.get_signed()?,
        ..Datum::default()
    };
    if has_declared {
        datum.declared = declared(input, datum.passes)?;
    }
    Some(datum)
}

fn put_declared(out: &mut VarintWriter, sums: &DeclaredSums) {
    out.put(u64::from(sums.passes));
    for sum in [sums.shift_mm[0], sums.shift_mm[1], sums.yaw_urad] {
        out.put_signed(sum);
    }
    for sum in [sums.weighted_shift[0], sums.weighted_shift[1], sums.weighted_yaw] {
        out.put_signed(sum);
    }
    out.put_all(sums.information.into_iter().chain(sums.squares));
}

fn declared(input: &mut impl Varints, passes: u32) -> Option<DeclaredSums> {
    let sums = DeclaredSums {
        passes: input.get().filter(|declared| (1..=passes).contains(declared))?,
        shift_mm: [input.get_signed()?, input.get_signed()?],
        yaw_urad: input.get_signed()?,
        weighted_shift: [input.get_signed()?, input.get_signed()?],
        weighted_yaw: input.get_signed()?,
        information: [input.get()?, input.get()?],
        squares: [input.get()?, input.get()?],
    };
    // What weighs nothing has no mean.
    (!sums.information.contains(&0)).then_some(sums)
}

/// The tile of its bytes.
///
/// # Errors
/// When the bytes are not a tile's, are damaged, or break the format.
pub fn decode(bytes: &[u8]) -> Result<Tile, DecodeError> {
    let newer = bytes.get(3).is_some_and(|version| *version > TILE.version);
    let format = if newer { DECLARED_TILE } else { TILE };
    unpacked(format.unseal(bytes)?, |columns| tile(columns, newer)).ok_or(DecodeError::Malformed)
}

/// What `read` makes of a frame's columns, once nothing of them is left.
fn unpacked<T>(frame: &[u8], read: impl FnOnce(&mut ColumnReader<'_>) -> Option<T>) -> Option<T> {
    let mut columns = ColumnReader::new(frame, MAX_DECODED)?;
    let read = read(&mut columns)?;
    columns.finish()?;
    Some(read)
}

fn tile(input: &mut impl Varints, has_declared: bool) -> Option<Tile> {
    let count = input.count_of(CELL_COLUMNS)?;
    let base_day: u16 = input.get()?;
    let mut tile = Tile { cells: cells(input, count, base_day)?, ..Tile::default() };
    sparse(input, &mut tile.observed[..])?;
    sparse(input, &mut tile.support[..])?;
    tile.datum = datum(input, has_declared)?;
    Some(tile)
}

/// The cells' columns. Cells take room only once the indices of all have been read, and a tile has no more of those than
/// cells.
fn cells(input: &mut impl Varints, count: usize, base_day: u16) -> Option<Vec<(u32, Cell)>> {
    let mut indices = Vec::new();
    input.ascending(count, CELLS, &mut indices)?;
    let mut cells: Vec<_> = indices.into_iter().map(|index| (index, Cell::default())).collect();
    for (_, cell) in &mut cells {
        cell.hits = input.get()?;
    }
    for (_, cell) in &mut cells {
        cell.passes = input.get()?;
    }
    for (_, cell) in &mut cells {
        cell.contributors = input.get()?;
    }
    for (_, cell) in &mut cells {
        cell.presence = ALWAYS - input.get::<u16>()?;
    }
    for (_, cell) in &mut cells {
        cell.first_day = base_day.checked_add(input.get()?)?;
    }
    for (_, cell) in &mut cells {
        cell.last_day = cell.first_day.checked_add(input.get()?)?;
    }
    for axis in [0, 1] {
        for (_, cell) in &mut cells {
            let most = u64::from(cell.hits) * u64::from(OFFSET_STEPS);
            cell.offset_sum[axis] = input.get().filter(|sum| u64::from(*sum) <= most)?;
        }
    }
    Some(cells)
}

/// The bytes of a ledger.
#[must_use]
pub fn encode_ledger(ledger: &Ledger) -> Vec<u8> {
    let mut out = VarintWriter::default();
    out.put(ledger.passes().count() as u64);
    for (pass, votes) in ledger.iter() {
        out.put(u64::from(pass.day));
        out.put(pass.contributor);
        out.bytes.extend_from_slice(votes.bytes());
    }
    LEDGER.seal(&sealed::compressed(&out.bytes, ZSTD_LEVEL))
}

/// The ledger of its bytes.
///
/// # Errors
/// When the bytes are not a ledger's, are damaged, or break the format.
pub fn decode_ledger(bytes: &[u8]) -> Result<Ledger, DecodeError> {
    let frame = LEDGER.unseal(bytes)?;
    unpacked(frame, ledger).ok_or(DecodeError::Malformed)
}

fn ledger(input: &mut ColumnReader<'_>) -> Option<Ledger> {
    let passes = input.count_of(LEAST_PASS)?;
    let (mut votes, mut weight) = (Vec::new(), 0);
    for _ in 0..passes {
        let pass = Pass { day: input.get()?, contributor: input.get()? };
        let said = EncodedVotes::take(input)?;
        weight = Some(weight + Ledger::weight(&said)).filter(|weight| *weight <= MAX_VOTES)?;
        votes.push((pass, said));
    }
    Some(votes.into_iter().collect())
}

/// The values that are not 0: their number, their indices, and they.
fn put_sparse<T: Copy + Into<u64>>(out: &mut VarintWriter, values: &[T]) {
    let set =
        || (0_u32..).zip(values).map(|(at, value)| (at, (*value).into())).filter(|(_, value)| *value != 0);
    out.put(set().count() as u64);
    out.put_ascending(set().map(|(at, _)| at));
    out.put_all(set().map(|(_, value)| value));
}

/// What [`put_sparse`] wrote, into zeros.
fn sparse<T: TryFrom<u64>>(input: &mut impl Varints, values: &mut [T]) -> Option<()> {
    let count = input.count_of(1)?;
    let mut set = Vec::new();
    input.ascending(count, values.len() as u32, &mut set)?;
    for at in set {
        let value = input.get::<u64>().filter(|value| *value != 0)?;
        values[at as usize] = T::try_from(value).ok()?;
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{folded, hits, uploads};
    use super::*;
    use crate::datum::{Offset, PoseSigma};
    use crate::evidence::TileEvidence;
    use proptest::prelude::*;

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
        fn garbage_is_refused_without_panic(body in prop::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(decode(&body).is_err());
            // Past the checksum, and past the compression, too.
            let _ = decode(&TILE.seal(&body));
            let _ = decode(&TILE.seal(&sealed::compressed(&body, 1)));
            let _ = decode(&DECLARED_TILE.seal(&sealed::compressed(&body, 1)));
            let _ = decode_ledger(&LEDGER.seal(&sealed::compressed(&body, 1)));
        }
    }

    /// Catches: sums that are lost on disk, and a version that every tile takes: what nobody declared anything of keeps its
    /// bytes.
    #[test]
    fn only_tiles_with_declared_sigmas_are_of_the_newer_format() {
        let (mut tile, mut ledger) = (Tile::default(), Ledger::default());
        let evidence = TileEvidence::of_hits(hits(&[(3, 1), (90, 2)].into()));
        let offset = Offset { east_mm: -120, north_mm: 40, yaw_urad: -900 };
        let sigmas =
            [PoseSigma::default(), PoseSigma::declared(0.25, 0.007), PoseSigma::declared(0.05, 0.002)];
        for (contributor, sigma) in (0..).zip(sigmas) {
            let pass = Pass { day: 20_000, contributor };
            tile.fold_moved(&mut ledger, pass, &evidence, offset, sigma);
            let bytes = encode(&tile);
            assert_eq!(bytes[3], if contributor == 0 { 3 } else { 4 });
            assert_eq!(decode(&bytes).as_ref(), Ok(&tile));
        }
        assert_eq!(decode(b"EFT\x05....").unwrap_err(), DecodeError::Version { found: 5, known: 4 });
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
    fn tiles_of_the_first_format_are_refused_with_what_to_do() {
        let error = decode(b"EFT\x01....").unwrap_err();
        assert_eq!(error, DecodeError::Version { found: 1, known: 3 });
    }

    #[test]
    fn an_empty_tile_has_an_encoding() {
        assert_eq!(decode(&encode(&Tile::default())), Ok(Tile::default()));
    }
}
