//! Values of any length, cut into pieces that suit sled: whole ones take several times their size on its disk. With
//! pieces, in its mode for low space, it settles below three times the encoded tiles and some megabytes more
//! (`docs/benchmarks/map.md`).
//!
//! ```text
//! key    key of the tile (10) | number of the piece (4), big-endian
//! value  the next 16 000 bytes of the whole; the last piece is what is left
//! ```
//!
//! What belongs together is written in one batch. A piece that is missing, torn or too many is noticed here, or by
//! the checksum of the whole.

use echofix_core::geo::TileId;

use super::key::{KEY, id, key};
use crate::store::api::Error;
use crate::store::backend::tables::{Batch, TileTable};

/// Bytes of every piece but the last.
const PIECE: usize = 16_000;
/// Bytes of a piece's key.
const PIECE_KEY: usize = KEY + 4;
/// Puts a value in place of the one before, with all its pieces, once the batch is applied.
///
/// # Errors
/// When the disk refuses.
pub(in crate::store) fn put(
    table: &dyn TileTable,
    batch: &mut Batch,
    tile: TileId,
    value: &[u8],
) -> Result<(), Error> {
    let mut next = 0;
    for piece in value.chunks(PIECE) {
        batch.put(&piece_key(tile, next), piece);
        next += 1;
    }
    for surplus in table.scan(&piece_key(tile, next)) {
        let (key, _) = surplus?;
        if tile_of(&key) != Some(tile) {
            break;
        }
        batch.remove(&key);
    }
    Ok(())
}

/// A whole value; `None` where there is no piece of it.
///
/// # Errors
/// When the disk refuses or the pieces do not fit together.
pub(in crate::store) fn get(table: &dyn TileTable, tile: TileId) -> Result<Option<Vec<u8>>, Error> {
    let mut whole = Vec::new();
    let prefix = key(tile);
    for entry in table.scan(&prefix) {
        let (at, piece) = entry?;
        if !at.starts_with(&prefix) {
            break;
        }
        let begins = piece_key(tile, (whole.len() / PIECE) as u32);
        if whole.len() % PIECE != 0 || at != begins || piece.is_empty() || piece.len() > PIECE {
            let reason = "its pieces do not fit together".to_owned();
            return Err(Error::Damaged { what: format!("tile {tile}"), reason });
        }
        whole.extend_from_slice(&piece);
    }
    Ok((!whole.is_empty()).then_some(whole))
}

/// The tile that a key is a piece of.
pub(super) fn tile_of(key: &[u8]) -> Option<TileId> {
    (key.len() == PIECE_KEY).then(|| id(&key[..KEY]))?
}

/// Behind all pieces of a tile.
pub(super) fn last_key(tile: TileId) -> [u8; PIECE_KEY] {
    piece_key(tile, u32::MAX)
}

fn piece_key(tile: TileId, number: u32) -> [u8; PIECE_KEY] {
    let mut bytes = [0; PIECE_KEY];
    bytes[..KEY].copy_from_slice(&key(tile));
    bytes[KEY..].copy_from_slice(&number.to_be_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::backend::memory::Memory;
    use crate::store::backend::tables::{TableId, TableUse};
    use echofix_core::geo::Zone;
    use proptest::prelude::*;
    use uuid::Uuid;

    fn table() -> Box<dyn TileTable> {
        Memory::default()
            .open()
            .tables
            .create(TableId { used: TableUse::Served, number: 1 }, Uuid::nil())
            .unwrap()
    }

    fn tile(x: i32) -> TileId {
        TileId { zone: Zone::from_epsg(32614).unwrap(), y: 2, x }
    }

    fn written(table: &dyn TileTable, tile: TileId, value: &[u8]) {
        let mut batch = Batch::default();
        put(table, &mut batch, tile, value).unwrap();
        table.apply(batch).unwrap();
    }

    /// Puts an entry as it is, or removes it.
    fn forced(table: &dyn TileTable, key: &[u8], value: Option<&[u8]>) {
        let mut batch = Batch::default();
        match value {
            Some(value) => batch.put(key, value),
            None => batch.remove(key),
        }
        table.apply(batch).unwrap();
    }

    fn value(length: usize, salt: usize) -> Vec<u8> {
        (0..length).map(|at| (at * 31 + salt * 7 + at / PIECE) as u8).collect()
    }

    proptest! {
        // Breaks it: leaving what a longer value had more, or counting pieces from the wrong end.
        #[test]
        fn a_value_is_the_last_that_was_written(
            writes in prop::collection::vec((0..3_i32, 1..5 * PIECE), 1..20), whole in 1..4_usize,
        ) {
            let table = &*table();
            let mut model = std::collections::BTreeMap::new();
            let exact = [(0, whole * PIECE), (1, whole * PIECE + 1), (2, whole * PIECE - 1)];
            for (salt, (x, length)) in writes.into_iter().chain(exact).enumerate() {
                written(table, tile(x), &value(length, salt));
                model.insert(x, value(length, salt));
                for x in 0..3 {
                    prop_assert_eq!(get(table, tile(x)).unwrap(), model.get(&x).cloned());
                }
                let pieces: usize = model.values().map(|value| value.len().div_ceil(PIECE)).sum();
                prop_assert_eq!(table.scan(b"").count(), pieces);
            }
        }

        // What these leave to be found by the checksum of the whole: a last piece that is missing or cut.
        #[test]
        fn pieces_that_do_not_fit_are_damage(length in 2 * PIECE + 1..5 * PIECE, at: prop::sample::Index) {
            let table = &*table();
            let value = value(length, 1);
            let pieces = length.div_ceil(PIECE) as u32;
            let at = at.index(pieces as usize - 1) as u32;
            let key = piece_key(tile(1), at);
            let damaged = |change: &dyn Fn()| {
                written(table, tile(1), &value);
                change();
                let found = get(table, tile(1));
                // Put right again by the next write.
                written(table, tile(1), &value);
                get(table, tile(1)).unwrap().as_ref() == Some(&value) && matches!(found, Err(Error::Damaged { .. }))
            };
            prop_assert!(damaged(&|| forced(table, &key, None)), "missing");
            prop_assert!(damaged(&|| forced(table, &key, Some(&value[..PIECE - 1]))), "torn");
            prop_assert!(damaged(&|| forced(table, &key, Some(&value[..=PIECE]))), "too long");
            prop_assert!(damaged(&|| forced(table, &key, Some(&[]))), "empty");
            prop_assert!(damaged(&|| forced(table, &piece_key(tile(1), pieces + 1), Some(b"x"))), "stray");
        }
    }
}
