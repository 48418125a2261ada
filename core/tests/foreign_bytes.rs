//! A few foreign bytes take little memory, whatever they say that they stand for.

#![expect(unsafe_code, reason = "an allocator that counts is an allocator")]

mod counted;

use counted::{Counting, peak};
use echofix_core::evidence::VIEW_BLOCKS;
use echofix_core::evidence::codec::{self, DeltaLimits};
use echofix_core::tile::{self, DecodeError};
use echofix_core::varint::VarintWriter;
use proptest::prelude::*;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Bytes that a message may take beyond its own.
const MOST: isize = 16 << 20;
const LIMITS: DeltaLimits = DeltaLimits { tiles: 4_096, cells: 500_000 };
const CELLS: u64 = 512 * 512;

fn sealed(magic: [u8; 3], version: u8, body: &[u8]) -> Vec<u8> {
    let sum = crc32c::crc32c(body).to_le_bytes();
    [&magic[..], &[version], &sum, body].concat()
}

fn packed(columns: &[u8]) -> Vec<u8> {
    zstd::bulk::compress(columns, 1).expect("it fits")
}

/// An upload of so many tiles and cells in each, as its head says; what follows is `columns`.
fn evidence(tiles: u64, cells: u64, columns: &[u8]) -> Vec<u8> {
    let mut out = VarintWriter::default();
    out.put_all([0, tiles].into_iter());
    for tile in 0..tiles {
        out.put(32_614);
        out.put_signed(65_000);
        out.put_signed(tile as i64);
        out.put(cells);
    }
    out.put(columns.len() as u64);
    out.bytes.extend(packed(columns));
    sealed(*b"EFC", 2, &out.bytes)
}

/// Columns of sound cells: nothing in view, one after the other, one hit each.
fn sound(tiles: u64, cells: u64) -> Vec<u8> {
    let all = (tiles * cells) as usize;
    [vec![0; tiles as usize + all], vec![1; all], vec![0; 2 * all]].concat()
}

/// Catches cells that are made before the bytes say that there are any: 167 MB of 826 bytes.
#[test]
fn an_upload_that_names_millions_of_cells_takes_little_memory() {
    for (tiles, cells) in [(16, CELLS), (4_096, 1_024), (40, CELLS), (1, CELLS)] {
        let bytes = evidence(tiles, cells, &vec![0; 10_000_000]);
        assert!(bytes.len() < 64 << 10, "{}", bytes.len());
        let (decoded, bytes) = peak(|| codec::decode_within(&bytes, LIMITS));
        assert!(decoded.is_err() && bytes < MOST, "{tiles} tiles of {cells}: {bytes} bytes");
    }
    let bytes = evidence(4_096, 122, &sound(4_096, 122));
    let (decoded, taken) = peak(|| codec::decode_within(&bytes, LIMITS));
    assert!(decoded.is_ok() && taken < MOST, "{taken} bytes for as much as is taken");
}

#[test]
fn an_upload_of_too_much_is_refused_by_its_head() {
    let bytes = evidence(1_700_000, 1, &[]);
    let (decoded, taken) = peak(|| codec::decode_within(&bytes, LIMITS));
    assert_eq!(decoded, Err(DecodeError::TooManyTiles { found: 1_700_000, most: 4_096 }));
    assert!(taken < 1 << 10, "{taken}");
    let bytes = evidence(2, CELLS, &sound(2, CELLS));
    let (decoded, taken) = peak(|| codec::decode_within(&bytes, LIMITS));
    assert_eq!(decoded, Err(DecodeError::TooManyCells { found: 2 * CELLS as usize, most: 500_000 }));
    assert!(taken < 1 << 10, "{taken}");
}

/// Columns of a tile or a ledger that begin with such numbers and go on with one byte.
fn filled(first: &[u64], byte: u8, bytes: usize) -> Vec<u8> {
    let mut out = VarintWriter::default();
    out.put_all(first.iter().copied());
    out.bytes.resize(out.bytes.len() + bytes, byte);
    packed(&out.bytes)
}

#[test]
fn tiles_and_ledgers_that_name_millions_take_little_memory() {
    for count in [CELLS, CELLS - 1, 1_000_000, u64::MAX] {
        for byte in [0, 1] {
            for room in [1_000, 9 * CELLS as usize, 15 << 20] {
                let tile = sealed(*b"EFT", 3, &filled(&[count, 0], byte, room));
                let (_, taken) = peak(|| tile::decode(&tile));
                assert!(taken < MOST, "tile of {count}: {taken} bytes");
                let ledger = sealed(*b"EFL", 2, &filled(&[count], byte, room));
                let (_, taken) = peak(|| tile::decode_ledger(&ledger));
                assert!(taken < MOST, "ledger of {count}: {taken} bytes");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Heads, lengths and columns that do not go together.
    #[test]
    fn whatever_a_head_says_a_message_takes_little_memory(
        tiles in 0..6_000_u64, cells in 0..=CELLS, byte in 0..3_u8, columns in 0..12_000_000_usize, cut in 0..100_usize,
    ) {
        let bytes = evidence(tiles, cells, &vec![byte; columns]);
        let (_, taken) = peak(|| codec::decode_within(&bytes, LIMITS));
        prop_assert!(taken < MOST, "{taken}");
        let short = &bytes[..bytes.len().saturating_sub(cut)];
        let again = sealed(*b"EFC", 2, short.get(8..).unwrap_or_default());
        let (_, taken) = peak(|| codec::decode_within(&again, LIMITS));
        prop_assert!(taken < MOST, "{taken}");
    }
}

#[test]
fn runs_of_blocks_beyond_a_tile_are_refused_before_they_are_read() {
    let columns = [&[0xff, 0xff, 0x3f][..], &vec![0; 4 << 20]].concat();
    let bytes = evidence(1, 0, &columns);
    let (decoded, taken) = peak(|| codec::decode_within(&bytes, LIMITS));
    assert!(decoded.is_err() && taken < 1 << 20, "{taken} bytes, {VIEW_BLOCKS} blocks");
}
