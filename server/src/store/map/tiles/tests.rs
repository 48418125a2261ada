use super::*;
use crate::store::backend::faulty::{Call, Fault, Faults};
use crate::store::backend::memory::Memory;
use crate::store::backend::tables::{Entry, TableId, TableUse};
use crate::store::map::key::stamp;
use echofix_core::evidence::{CellHits, Pass, TileEvidence};
use echofix_core::geo::Zone;
use proptest::prelude::*;
use uuid::Uuid;

fn id(x: i32) -> TileId {
    TileId { zone: Zone::from_epsg(32614).unwrap(), y: 2, x }
}

/// A tile in a version, of so many cells.
fn value(x: i32, version: u64, cells: u32) -> TileValue {
    let mut folded = Folded { version, ..Folded::default() };
    // Nothing that could be compressed away.
    let noise = |at: u32| at.wrapping_mul(0x9e37_79b9) >> 8;
    let hit = |at: u32| CellHits {
        index: at * 13,
        hits: 99,
        offset_sum: [noise(at) % 25_000, noise(!at) % 25_000],
    };
    let evidence = TileEvidence::of_hits((0..cells).map(hit).collect());
    folded.tile.fold(&mut folded.ledger, Pass { day: 20_000, contributor: 7 }, &evidence);
    TileValue::new(id(x), &folded, 1)
}

fn tiles() -> TileStore {
    let id = TableId { used: TableUse::Served, number: 1 };
    TileStore::of(Memory::default().open().tables.create(id, Uuid::nil()).unwrap())
}

/// Puts an entry as it is, or removes it.
fn forced(tiles: &TileStore, key: &[u8], value: Option<&[u8]>) {
    let mut batch = Batch::default();
    match value {
        Some(value) => batch.put(key, value),
        None => batch.remove(key),
    }
    tiles.table().apply(batch).unwrap();
}

/// The pieces of a tile.
fn pieces(tiles: &TileStore, x: i32) -> Vec<Entry> {
    let of_tile = |entry: &Entry| pieces::tile_of(&entry.0) == Some(id(x));
    tiles.table().scan(&key(id(x))).map(Result::unwrap).take_while(of_tile).collect()
}

proptest! {
    // Breaks it: leaving out the end of the value from the checksum, or skipping pieces that are not there.
    #[test]
    fn a_changed_lost_or_cut_piece_is_noticed(
        at: prop::sample::Index, piece: prop::sample::Index, bit in 0..8_u8, of_state: bool,
    ) {
        let tiles = tiles();
        let value = value(-1, 3, 8000);
        let digest = stamp(&value.info);
        tiles.put_all(vec![value], &[], 3, digest).unwrap();
        prop_assert_eq!(tiles.check().unwrap().1, 3);
        let pieces = pieces(&tiles, -1);
        prop_assert!(pieces.len() > 2);
        let key = if of_state { STATE.to_vec() } else { pieces[piece.index(pieces.len())].0.clone() };
        let good = tiles.table().get(&key).unwrap().unwrap();
        let at = at.index(good.len());
        let mut bad = good.clone();
        bad[at] ^= 1_u8 << bit;
        for bad in [Some(&bad[..]), Some(&good[..at]), None] {
            forced(&tiles, &key, bad);
            prop_assert!(tiles.check().is_err());
            let damaged = |error| matches!(error, Some(Error::Damaged { .. }));
            prop_assert!(of_state || damaged(tiles.stored(id(-1)).err()));
            prop_assert!(of_state || damaged(tiles.folded(id(-1)).err()));
        }
        forced(&tiles, &key, Some(&good));
        prop_assert!(tiles.check().is_ok());
    }
}

#[test]
fn a_lost_or_older_tile_and_what_nobody_knows_are_noticed() {
    let tiles = tiles();
    let digest = stamp(&value(1, 3, 1).info).wrapping_add(stamp(&value(2, 5, 1).info));
    tiles.put_all(vec![value(1, 3, 1), value(2, 5, 1)], &[], 5, digest).unwrap();
    assert!(tiles.check().is_ok());
    let (at, piece) = pieces(&tiles, 1).remove(0);
    forced(&tiles, &at, None);
    assert!(tiles.check().is_err());
    forced(&tiles, &at, Some(&piece));
    assert!(tiles.check().is_ok());
    forced(&tiles, &key(id(1)), Some(&value(1, 3, 1).bytes));
    assert!(tiles.check().is_err(), "a tile as it was stored before there were pieces");
    forced(&tiles, &key(id(1)), None);
    forced(&tiles, &at, Some(&value(1, 2, 1).bytes));
    assert!(tiles.check().is_err());
}

/// Breaks it: reading the table as it is after a batch that failed.
#[test]
fn after_a_write_that_failed_the_tiles_are_as_before() {
    for fault in [Fault::Torn, Fault::LostAnswer, Fault::Error] {
        let faults = Faults::default();
        let table = TableId { used: TableUse::Served, number: 1 };
        let tables = faults.around(Memory::default().open()).tables;
        let tiles = TileStore::of(tables.create(table, Uuid::nil()).unwrap());
        tiles.put_all(vec![value(1, 3, 9000), value(2, 3, 9000)], &[], 3, 0).unwrap();
        faults.name(Call::Apply(TableUse::Served), fault);
        let failed = tiles.put_all(vec![value(1, 4, 9999), value(2, 4, 9999), value(3, 4, 1)], &[], 4, 0);
        assert!(failed.is_err() && tiles.broken().is_some(), "{fault:?}");
        faults.heal();
        let versions = [1, 2, 3].map(|x| tiles.stored(id(x)).unwrap().map(|(version, _)| version));
        assert_eq!(versions, [Some(3), Some(3), None], "{fault:?}");
        assert!(matches!(tiles.put_all(Vec::new(), &[], 5, 0), Err(Error::Broken(_))), "for good");
    }
}
