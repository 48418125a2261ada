//! Rules of objects, segments, manifests and owners.

use std::io::{ErrorKind, Read};

use super::Place;
use crate::store::api::Error;
use crate::store::backend::Backend;
use crate::store::backend::objects::{Objects, Readable, reader};
use crate::store::backend::segments::HEADER;

fn put(objects: &dyn Objects, name: &str, bytes: &[u8]) -> std::io::Result<()> {
    objects.put_new(name, &mut |out| out.write_all(bytes))
}

fn whole(object: Box<dyn Readable>) -> Vec<u8> {
    let mut bytes = Vec::new();
    reader(object).unwrap().read_to_end(&mut bytes).unwrap();
    bytes
}

fn read(objects: &dyn Objects, name: &str) -> Vec<u8> {
    whole(objects.open(name).unwrap())
}

fn header(byte: u8) -> [u8; HEADER] {
    [byte; HEADER]
}

/// A backend whose journal was begun: some refuse to be opened without one, once they hold anything.
fn begun(place: &dyn Place) -> Backend {
    let backend = place.open();
    drop(backend.segments.create(1, &header(1)).unwrap());
    backend
}

pub(in crate::store) fn an_object_is_whole_and_stays(place: &dyn Place) {
    let backend = begun(place);
    let large: Vec<u8> = (0..300_000_u32).map(|at| (at / 7) as u8).collect();
    put(&*backend.objects, "base-1", &large).unwrap();
    put(&*backend.objects, "base-2", b"").unwrap();
    drop(backend);
    let objects = place.open().objects;
    assert_eq!(read(&*objects, "base-1"), large);
    assert_eq!(read(&*objects, "base-2"), b"");
    let object = objects.open("base-1").unwrap();
    let mut part = [0; 10];
    object.read_at(200_001, &mut part).unwrap();
    assert_eq!(part, large[200_001..200_011]);
    let beyond = object.read_at(large.len() as u64 - 9, &mut part);
    assert_eq!(beyond.unwrap_err().kind(), ErrorKind::UnexpectedEof);
    assert_eq!(objects.list("base-").unwrap(), ["base-1", "base-2"]);
    assert_eq!(objects.list("base-2").unwrap(), ["base-2"]);
    assert!(objects.list("nothing").unwrap().is_empty());
}

pub(in crate::store) fn a_name_is_given_once(place: &dyn Place) {
    let objects = place.open().objects;
    put(&*objects, "base-1", b"first").unwrap();
    assert_eq!(put(&*objects, "base-1", b"second").unwrap_err().kind(), ErrorKind::AlreadyExists);
    assert_eq!(read(&*objects, "base-1"), b"first");
    objects.delete("base-1").unwrap();
    put(&*objects, "base-1", b"third").unwrap();
    assert_eq!(read(&*objects, "base-1"), b"third");
}

/// Breaks it: looking whether a name is free, and putting the object then.
pub(in crate::store) fn of_racing_puts_one_wins(place: &dyn Place) {
    let backend = place.open();
    for round in 0..8 {
        let name = format!("base-{round}");
        let put = |racer: u8| put(&*backend.objects, &name, &[racer; 3000]).is_ok();
        let put = &put;
        let won: Vec<u8> = std::thread::scope(|scope| {
            let racers: Vec<_> =
                (0..8).map(|racer| scope.spawn(move || put(racer).then_some(racer))).collect();
            racers.into_iter().filter_map(|racer| racer.join().unwrap()).collect()
        });
        assert_eq!(won.len(), 1, "{won:?} have {name}");
        assert_eq!(read(&*backend.objects, &name), [won[0]; 3000]);
    }
}

pub(in crate::store) fn a_put_that_fails_leaves_nothing(place: &dyn Place) {
    let objects = place.open().objects;
    let failed = objects.put_new("base-1", &mut |out| {
        out.write_all(&vec![7; 100_000])?;
        Err(ErrorKind::InvalidData.into())
    });
    assert!(failed.is_err());
    assert!(objects.list("").unwrap().iter().all(|name| !name.starts_with("base-")));
    assert_eq!(objects.open("base-1").err().unwrap().kind(), ErrorKind::NotFound);
    put(&*objects, "base-1", b"whole").unwrap();
}

/// Breaks it: a backup that a compaction takes what it reads from.
pub(in crate::store) fn an_opened_object_outlives_its_name(place: &dyn Place) {
    let objects = place.open().objects;
    put(&*objects, "base-1", b"first").unwrap();
    let opened = objects.open("base-1").unwrap();
    objects.delete("base-1").unwrap();
    put(&*objects, "base-1", b"second").unwrap();
    assert_eq!(whole(opened), b"first");
}

pub(in crate::store) fn deleting_what_is_not_there_is_no_error(place: &dyn Place) {
    let backend = begun(place);
    backend.objects.delete("base-9").unwrap();
    backend.segments.delete(&[9]).unwrap();
}

pub(in crate::store) fn a_segment_holds_what_was_synced(place: &dyn Place) {
    let backend = place.open();
    let mut segment = backend.segments.create(1, &header(1)).unwrap();
    let read = |backend: &Backend| whole(backend.segments.open(1).unwrap());
    assert_eq!(read(&backend), header(1));
    for part in [&b"one"[..], b"two"] {
        segment.append(part).unwrap();
        segment.sync().unwrap();
    }
    let expected = [&header(1)[..], b"onetwo"].concat();
    assert_eq!(read(&backend), expected);
    drop((segment, backend));
    let backend = place.open();
    assert_eq!(read(&backend), expected);
    assert!(backend.segments.open(2).is_err());
}

pub(in crate::store) fn a_segment_is_begun_once(place: &dyn Place) {
    let segments = place.open().segments;
    drop(segments.create(1, &header(1)).unwrap());
    assert_eq!(segments.create(1, &header(2)).err().unwrap().kind(), ErrorKind::AlreadyExists);
    assert_eq!(whole(segments.open(1).unwrap()), header(1));
    segments.delete(&[1]).unwrap();
    drop(segments.create(1, &header(2)).unwrap());
    assert_eq!(whole(segments.open(1).unwrap()), header(2));
}

/// Breaks it: two servers whose records get into one segment.
pub(in crate::store) fn who_writes_to_a_replaced_segment_writes_nowhere(place: &dyn Place) {
    let segments = place.open().segments;
    let mut lost = segments.create(1, &header(1)).unwrap();
    let mut ours = segments.replace(1, &header(2)).unwrap();
    lost.append(b"theirs").unwrap();
    lost.sync().unwrap();
    ours.append(b"ours").unwrap();
    ours.sync().unwrap();
    assert_eq!(whole(segments.open(1).unwrap()), [&header(2)[..], b"ours"].concat());
}

pub(in crate::store) fn a_segment_is_cut_and_goes_on(place: &dyn Place) {
    let backend = place.open();
    let mut segment = backend.segments.create(1, &header(1)).unwrap();
    segment.append(b"whole and torn").unwrap();
    drop((segment, backend));
    let segments = place.open().segments;
    let mut segment = segments.resume(1).unwrap();
    segment.cut(HEADER as u64 + 5).unwrap();
    segment.append(b", next").unwrap();
    segment.sync().unwrap();
    assert_eq!(whole(segments.open(1).unwrap()), [&header(1)[..], b"whole, next"].concat());
}

pub(in crate::store) fn segments_are_listed_in_order_and_deleted(place: &dyn Place) {
    let segments = place.open().segments;
    for first in [7, 1, 300] {
        let mut segment = segments.create(first, &header(1)).unwrap();
        segment.append(&vec![1; first as usize]).unwrap();
        segment.sync().unwrap();
    }
    let listed = |segments: &dyn super::super::segments::Segments| -> Vec<_> {
        segments.list().unwrap().iter().map(|listed| (listed.first, listed.bytes - HEADER as u64)).collect()
    };
    assert_eq!(listed(&*segments), [(1, 1), (7, 7), (300, 300)]);
    segments.delete(&[1, 300]).unwrap();
    assert_eq!(listed(&*segments), [(7, 7)]);
}

pub(in crate::store) fn the_newest_manifest_counts(place: &dyn Place) {
    let backend = begun(place);
    assert_eq!(backend.manifests.newest().unwrap(), None);
    for manifest in [&b"EFM one"[..], b"EFM two"] {
        backend.manifests.publish(manifest).unwrap();
        assert_eq!(backend.manifests.newest().unwrap().unwrap(), manifest);
    }
    drop(backend);
    let backend = place.open();
    assert_eq!(backend.manifests.newest().unwrap().unwrap(), b"EFM two");
    backend.manifests.publish(b"EFM three").unwrap();
    assert_eq!(backend.manifests.newest().unwrap().unwrap(), b"EFM three");
}

pub(in crate::store) fn a_manifest_that_is_set_aside_is_none(place: &dyn Place) {
    let backend = begun(place);
    for _ in 0..2 {
        backend.manifests.publish(b"EFM one").unwrap();
        backend.manifests.set_aside("a test says so").unwrap();
        assert_eq!(backend.manifests.newest().unwrap(), None);
    }
}

/// Only a backend that can be taken over while it is open can be asked: the others refuse the second opening.
pub(in crate::store) fn who_was_taken_over_publishes_nothing(place: &dyn Place) {
    let first = begun(place);
    first.fence.check().unwrap();
    first.manifests.publish(b"EFM one").unwrap();
    let opened = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| place.open()));
    let Ok(second) = opened else { return };
    second.fence.check().unwrap();
    assert!(matches!(first.fence.check(), Err(Error::Stopped(_))));
    assert!(matches!(first.manifests.publish(b"EFM two"), Err(Error::Stopped(_))));
    assert_eq!(second.manifests.newest().unwrap().unwrap(), b"EFM one");
}

pub(in crate::store) fn pseudonyms_keep_their_hashes(place: &dyn Place) {
    let hash = |name: &str| place.open().pseudonyms.hash(name);
    assert_eq!(hash("car-1"), hash("car-1"));
    assert_ne!(hash("car-1"), hash("car-2"));
    let backend = place.open();
    assert!(backend.pseudonyms.damage().is_empty());
    assert!(!read(&*backend.objects, super::super::owner::KEY).is_empty(), "for backups");
}
