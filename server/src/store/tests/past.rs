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
        what: EventKind::Control { at_us, decision, takes_back, remark: Remark::default(), undone_by: None },
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
        control(7, Decision::RevokeContributor(one), 2),
        run(5, 6, 101, 1, 0),
        run(1, 4, 100, 2, 2),
    ];
    assert_eq!(store.history(10), expected);
    assert_eq!(store.history(2), expected[..2]);
}

/// Catches: a rollback that cannot be undone, an undoing that brings back something else than what was taken, a preview
/// that tells another change than the decision makes, and a remark that is lost with the process.
#[test]
fn a_rollback_is_foretold_undone_and_done_again() {
    let dir = tempfile::tempdir().unwrap();
    let mut store = open(dir.path());
    let uploads = by_cars(&store, some_uploads(12));
    commit_all(&store, &uploads);
    let before = bytes(&store);
    let remark = Remark { by: Some("anna".to_owned()), reason: Some("a shifted street".to_owned()) };
    for (proposal, after) in [
        (Proposal::Rollback(5), never_had(&uploads[..5])),
        (Proposal::Undo(13), before.clone()),
        (Proposal::Undo(14), never_had(&uploads[..5])),
        (Proposal::Undo(15), before.clone()),
    ] {
        let (was, foretold) = (store.at(store.epochs().1).unwrap(), store.preview(&proposal).unwrap());
        assert_eq!(foretold.uploads_out + foretold.uploads_back, 7, "{proposal:?}");
        let number = store.decide(&proposal, &remark).unwrap().unwrap();
        assert_eq!(bytes(&store), after, "{proposal:?}");
        assert_eq!(was.diff(&store.at(number).unwrap()), foretold.tiles, "{proposal:?}");
        assert!(!foretold.tiles.is_empty());
        drop(store);
        store = open(dir.path());
        assert_eq!(bytes(&store), after, "{proposal:?}, after a restart");
    }
    let controls: Vec<_> = store.history(10).into_iter().map(|event| event.what).collect();
    let EventKind::Control { remark: kept, undone_by, takes_back, .. } = &controls[3] else {
        panic!("{controls:?}")
    };
    // The second undoing undid the first, and the third that one: the rollback is undone by the first again.
    assert_eq!((kept, *undone_by, *takes_back), (&remark, Some(14), 7));
    assert!(matches!(store.decide(&Proposal::Undo(13), &remark), Err(Error::Unknown(_))), "it is undone");
    assert!(matches!(store.decide(&Proposal::Undo(3), &remark), Err(Error::Unknown(_))), "an upload");
}

/// Catches: an undoing that brings back less than was taken, since a compaction was faster.
#[test]
fn what_is_compacted_is_not_brought_back() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = by_cars(&store, some_uploads(8));
    TODAY.set(Some(100));
    commit_all(&store, &uploads);
    store.rollback(3).unwrap();
    TODAY.set(Some(101));
    let remark = Remark::default();
    assert!(matches!(store.decide(&Proposal::Compact(103), &remark), Err(Error::Unusable(_))), "the future");
    let compact = Proposal::Compact(101);
    assert_eq!(store.preview(&compact).unwrap().compacted, 8);
    let compacted = store.decide(&compact, &remark).unwrap().unwrap();
    for number in [9, compacted] {
        let refused = store.decide(&Proposal::Undo(number), &remark);
        assert!(matches!(&refused, Err(Error::Unknown(why)) if why.contains("compacted")), "{refused:?}");
    }
    caught_up(&store);
    assert!(store.preview(&Proposal::Undo(9)).is_err());
    assert_eq!(bytes(&store), never_had(&uploads[..3]));
}

/// Catches: a map of the past that shows what was not published then, or not what was.
#[test]
fn a_map_of_the_past_is_served_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path());
    let uploads = by_cars(&store, some_uploads(9));
    let mut then = Vec::new();
    for upload in &uploads {
        store.commit(upload.clone()).unwrap();
        caught_up(&store);
        then.push(shown(&store));
    }
    store.rollback(2).unwrap();
    caught_up(&store);
    for (epoch, served) in (1..).zip(then) {
        assert_eq!(shown(&*store.served_at(epoch).unwrap()), served, "epoch {epoch}");
    }
    assert!(store.served_at(99).is_err());
}

/// All that a map shows: its tiles' ids, cells and versions, and it in numbers.
fn shown(store: &dyn MapStore) -> (Vec<(TileId, u64, Vec<u8>)>, Totals) {
    let all = |zone| store.catalog(zone, i32::MIN..=i32::MAX, i32::MIN..=i32::MAX).unwrap();
    let tiles = store.zones().into_iter().flat_map(all).map(|info| {
        let stored = store.tile(info.id).unwrap().unwrap();
        (info.id, stored.version, stored.encoded())
    });
    // How large a tile is stored is another matter.
    (tiles.collect(), Totals { bytes: 0, ..store.totals() })
}
