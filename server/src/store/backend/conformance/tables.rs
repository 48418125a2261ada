//! Rules of tables.

use uuid::Uuid;

use super::Place;
use crate::store::backend::Backend;
use crate::store::backend::segments::HEADER;
use crate::store::backend::tables::{Batch, Entry, TableId, TableUse, TileTable};

const JOURNAL: Uuid = Uuid::from_u128(5);

fn served(number: u64) -> TableId {
    TableId { used: TableUse::Served, number }
}

fn scratch(number: u64) -> TableId {
    TableId { used: TableUse::Scratch, number }
}

/// A backend whose journal was begun: some refuse to be opened without one, once they hold anything.
fn begun(place: &dyn Place) -> Backend {
    let backend = place.open();
    drop(backend.segments.create(1, &[1; HEADER]).unwrap());
    backend
}

fn batch(puts: &[(&[u8], &[u8])], removed: &[&[u8]]) -> Batch {
    let mut batch = Batch::default();
    for (key, value) in puts {
        batch.put(key, value);
    }
    for key in removed {
        batch.remove(key);
    }
    batch
}

fn all(table: &dyn TileTable, from: &[u8]) -> Vec<Entry> {
    table.scan(from).collect::<Result<_, _>>().unwrap()
}

fn entry(key: &[u8], value: &[u8]) -> Entry {
    (key.to_vec(), value.to_vec())
}

pub(in crate::store) fn a_table_gives_what_was_put(place: &dyn Place) {
    let backend = begun(place);
    let table = backend.tables.create(served(1), JOURNAL).unwrap();
    assert_eq!(table.get(b"a").unwrap(), None);
    assert_eq!(all(&*table, b""), []);
    let large = vec![9; 200_000];
    table.apply(batch(&[(b"a", b"one"), (b"b", &large), (b"c", b"")], &[])).unwrap();
    assert_eq!(table.get(b"a").unwrap().unwrap(), b"one");
    assert_eq!(table.get(b"b").unwrap().unwrap(), large);
    assert_eq!(table.get(b"c").unwrap().unwrap(), b"");
    table.apply(batch(&[(b"a", b"two")], &[b"b", b"none"])).unwrap();
    assert_eq!(all(&*table, b""), [entry(b"a", b"two"), entry(b"c", b"")]);
    // Of one key the last change counts.
    let mut both = batch(&[(b"d", b"put")], &[b"d"]);
    table.apply(both.clone()).unwrap();
    assert_eq!(table.get(b"d").unwrap(), None);
    both.put(b"d", b"again");
    table.apply(both).unwrap();
    assert_eq!(table.get(b"d").unwrap().unwrap(), b"again");
    assert_eq!(table.broken(), None);
    assert!(table.room_for(1).is_ok());
}

pub(in crate::store) fn entries_come_in_the_order_of_their_keys(place: &dyn Place) {
    let backend = begun(place);
    let table = backend.tables.create(served(1), JOURNAL).unwrap();
    let key = |at: u32| (at.wrapping_mul(0x9e37_79b9)).to_be_bytes();
    for part in 0..4 {
        let mut batch = Batch::default();
        (0..250).for_each(|at| batch.put(&key(part * 250 + at), &at.to_le_bytes()));
        table.apply(batch).unwrap();
    }
    table.apply(batch(&[(b"\x80", b"a prefix"), (b"\x80\x00\x00\x00\x00", b"longer")], &[])).unwrap();
    let found = all(&*table, b"");
    assert_eq!(found.len(), 1002);
    assert!(found.is_sorted_by(|a, b| a.0 < b.0));
    for from in [&b"\x80"[..], b"\x7f\xff\xff\xff\xff", b"\xff\xff\xff\xff\xff"] {
        let expected: Vec<_> = found.iter().filter(|(key, _)| &key[..] >= from).cloned().collect();
        assert_eq!(all(&*table, from), expected, "{from:?}");
    }
    assert_eq!(table.scan(b"\x80").next().unwrap().unwrap(), entry(b"\x80", b"a prefix"), "it is with them");
}

pub(in crate::store) fn a_batch_survives_the_table(place: &dyn Place) {
    let backend = begun(place);
    for (round, number) in (0..5_u8).zip([1, 1, 1, 2, 1]) {
        let table = match backend.tables.open(served(number)).unwrap() {
            Some(table) => table,
            None => backend.tables.create(served(number), JOURNAL).unwrap(),
        };
        table.apply(batch(&[(b"last", &[round]), (&[round], &vec![round; 50_000])], &[])).unwrap();
    }
    drop(backend);
    let tables = place.open().tables;
    let table = tables.open(served(1)).unwrap().unwrap();
    assert_eq!(table.get(b"last").unwrap().unwrap(), [4]);
    let kept: Vec<_> = all(&*table, b"").into_iter().filter(|(key, _)| key.len() == 1).collect();
    assert_eq!(kept, [0_u8, 1, 2, 4].map(|round| entry(&[round], &vec![round; 50_000])));
}

pub(in crate::store) fn a_table_says_what_it_was_made_from(place: &dyn Place) {
    let backend = begun(place);
    let table = backend.tables.create(served(1), JOURNAL).unwrap();
    table.apply(batch(&[(b"a", b"one")], &[])).unwrap();
    assert_eq!(table.made_from().unwrap(), None, "it is not complete");
    table.complete(JOURNAL).unwrap();
    table.flush().unwrap();
    assert_eq!(all(&*table, b"").len(), 1, "that is no entry");
    drop(table);
    let table = backend.tables.open(served(1)).unwrap().unwrap();
    assert_eq!(table.made_from().unwrap(), Some(JOURNAL));
    table.adopt(JOURNAL).unwrap();
}

pub(in crate::store) fn a_table_is_made_once(place: &dyn Place) {
    let backend = begun(place);
    let table = backend.tables.create(served(1), JOURNAL).unwrap();
    table.apply(batch(&[(b"a", b"one")], &[])).unwrap();
    drop(table);
    assert!(backend.tables.create(served(1), JOURNAL).is_err());
    drop(backend.tables.create(scratch(1), JOURNAL).unwrap());
    let table = backend.tables.open(served(1)).unwrap().unwrap();
    assert_eq!(all(&*table, b""), [entry(b"a", b"one")]);
}

pub(in crate::store) fn a_table_that_is_not_there_is_none(place: &dyn Place) {
    assert!(begun(place).tables.open(served(1)).unwrap().is_none());
}

pub(in crate::store) fn a_retired_table_goes_when_it_is_dropped(place: &dyn Place) {
    let backend = begun(place);
    let table = backend.tables.create(served(1), JOURNAL).unwrap();
    table.apply(batch(&[(b"a", b"one")], &[])).unwrap();
    table.retire();
    assert_eq!(table.get(b"a").unwrap().unwrap(), b"one", "who has it reads on");
    drop(table);
    assert!(backend.tables.open(served(1)).unwrap().is_none());
}

pub(in crate::store) fn numbers_are_free(place: &dyn Place) {
    let backend = begun(place);
    for id in [served, scratch, served] {
        let id = id(backend.tables.next_number().unwrap());
        drop(backend.tables.create(id, JOURNAL).unwrap());
    }
}

pub(in crate::store) fn cleaning_leaves_what_is_served(place: &dyn Place) {
    let theirs = Uuid::from_u128(6);
    let backend = begun(place);
    for (id, journal) in
        [(served(1), JOURNAL), (served(2), JOURNAL), (scratch(3), JOURNAL), (served(4), theirs)]
    {
        drop(backend.tables.create(id, journal).unwrap());
    }
    let is_there = |id| backend.tables.open(id).unwrap().is_some();
    backend.tables.clean(JOURNAL, Some(2), true).unwrap();
    assert!(is_there(served(2)));
    assert!(!is_there(served(1)) && !is_there(scratch(3)));
}
