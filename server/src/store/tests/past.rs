//! Time travel.

use super::controls::{by_cars, bytes, never_had};
use super::*;

/// The encoded tiles of a map of the past; those without any cell are as good as none.
fn past(store: &EmbeddedStore, epoch: u64) -> BTreeMap<TileId, Vec<u8>> {
    let tiles = store.at(epoch).unwrap().tiles.into_iter();
    tiles.map(|(id, tile)| (id, tile::encode(&tile))).collect()
}

#[test]
fn the_past_is_what_was_served_then() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = by_cars(&store, some_uploads(12));
    let mut served = vec![bytes(&store)];
    for upload in &uploads {
        store.commit(upload.clone()).unwrap();
        served.push(bytes(&store));
    }
    store.rollback(5).unwrap();
    served.push(bytes(&store));
    store.revoke_contributor("car-1").unwrap();
    served.push(bytes(&store));
    for (epoch, served) in (0..).zip(&served) {
        assert_eq!(past(&store, epoch), *served, "epoch {epoch}");
    }
    assert!(matches!(store.at(15), Err(Error::Unknown(_))));
    let forth = store.diff(5, 12).unwrap();
    let added = |diffs: &[TileDiff]| diffs.iter().map(|d| u64::from(d.added)).sum::<u64>();
    assert!(added(&forth) > 0 && forth.iter().all(|d| d.removed == 0));
    assert_eq!(store.diff(12, 13).unwrap().iter().map(|d| u64::from(d.removed)).sum::<u64>(), added(&forth));
    assert_eq!(store.diff(5, 13).unwrap(), []);
}

#[test]
fn the_past_reaches_back_to_the_base() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = by_cars(&store, some_uploads(10));
    TODAY.set(Some(100));
    commit_all(&store, &uploads[..4]);
    TODAY.set(Some(101));
    commit_all(&store, &uploads[4..]);
    store.compact(101).unwrap();
    caught_up(&store);
    assert!(matches!(store.at(3), Err(Error::Unknown(_))));
    assert_eq!(past(&store, 4), never_had(&uploads[..4]));
}

#[test]
fn history_groups_uploads_and_tells_what_controls_did() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let mut uploads = by_cars(&store, some_uploads(9));
    let (one, two) = (store.contributor("car-1"), store.contributor("car-2"));
    for (i, upload) in uploads.iter_mut().enumerate() {
        upload.pass.contributor = if i % 3 == 0 { one } else { two };
    }
    TODAY.set(Some(100));
    commit_all(&store, &uploads[..4]);
    TODAY.set(Some(101));
    commit_all(&store, &uploads[4..6]);
    store.revoke_contributor("car-1").unwrap();
    commit_all(&store, &uploads[6..]);
    store.rollback(8).unwrap();
    let at_us = 101 * echofix_core::time::DAY_US;
    let control = |number, decision, takes_back| HistoryEvent {
        first: number,
        last: number,
        day: 101,
        what: EventKind::Control { at_us, decision, takes_back },
    };
    let run = |first, last, day, contributors, taken_back| HistoryEvent {
        first,
        last,
        day,
        what: EventKind::Uploads { uploads: last - first + 1, contributors, taken_back },
    };
    let expected = [
        control(11, Decision::Rollback(8), 2),
        run(8, 10, 101, 2, 2),
        control(7, Decision::RevokeContributor, 2),
        run(5, 6, 101, 1, 0),
        run(1, 4, 100, 2, 2),
    ];
    assert_eq!(store.history(10), expected);
    assert_eq!(store.history(2), expected[..2]);
}
