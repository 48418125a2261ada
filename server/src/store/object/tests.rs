//! The four rules, each with what is lost without it; and a fleet of servers whose acknowledgements are the judge.

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use uuid::Uuid;

use super::bucket::{Bucket, Created};
use super::client::{Client, Put};
use super::cluster::Cluster;
use super::collect::{Swept, sweep};
use super::manifest::Manifest;
use super::names::Shard;
use super::probe::probe;
use super::shared_log::{Appended, Check, Peeked, SegmentRecords, SharedLog};
use super::testing::{Failing, Ignoring, client, memory};
use crate::store::api::Error;

const SHARD: Shard = Shard(0);
const CLUSTER: Uuid = Uuid::from_u128(77);
/// Everything is old by then.
const LATE: (i64, Duration) = (i64::MAX, Duration::ZERO);

fn log_with(client: &Client, check: Check) -> SharedLog {
    SharedLog::open(client.clone(), SHARD, (CLUSTER, Uuid::now_v7()), check).unwrap()
}

fn log(client: &Client) -> SharedLog {
    log_with(client, Check::default())
}

fn record(id: u64) -> Vec<u8> {
    id.to_le_bytes().to_vec()
}

fn id(record: &[u8]) -> u64 {
    u64::from_le_bytes(record.try_into().unwrap())
}

/// Appends one record where the journal ends.
fn append(log: &mut SharedLog, of: u64) {
    loop {
        match log.append(vec![record(of)]).unwrap() {
            Appended::Written(done) => return log.advance(&done),
            Appended::Behind => drop(read_on(log)),
            Appended::Passed => panic!("the floor has passed it"),
        }
    }
}

/// Reads to the end.
fn read_on(log: &mut SharedLog) -> Result<Vec<u64>, Error> {
    let mut ids = Vec::new();
    loop {
        match log.peek()? {
            Peeked::Nothing => return Ok(ids),
            Peeked::Segment(segment) => {
                ids.extend(segment.records.iter().map(|record| id(record)));
                log.advance(&segment);
            }
            Peeked::Passed => return Err(Error::Stopped("the floor has passed it".to_owned())),
        }
    }
}

/// What a pack of these tests holds: ids.
fn packed(client: &Client, manifest: &Manifest) -> Result<Vec<u64>, Error> {
    let Some(name) = &manifest.pack else { return Ok(Vec::new()) };
    let lost = || Error::Unknown(format!("{name} is gone"));
    let pack = client.get(name)?.ok_or_else(lost)?;
    Ok(pack.chunks_exact(8).map(id).collect())
}

/// All that counts: what is in the newest pack, and in the journal behind it.
fn counted(client: &Client) -> Result<Vec<u64>, Error> {
    let mut log = log(client);
    let manifest = log.chain().known().clone();
    let mut ids = packed(client, &manifest)?;
    ids.extend(read_on(&mut log)?);
    Ok(ids)
}

/// Folds all there is into a pack, and says so; `None` when another was first.
fn fold(client: &Client) -> Result<Option<Manifest>, Error> {
    let mut log = SharedLog::open(client.clone(), SHARD, (CLUSTER, Uuid::now_v7()), Check::default())?;
    let manifest = next_manifest(client, &mut log)?;
    Ok(log.chain().publish(manifest)?.then(|| log.chain().known().clone()))
}

fn next_manifest(client: &Client, log: &mut SharedLog) -> Result<Manifest, Error> {
    let before = log.chain().known().clone();
    let mut ids = packed(client, &before)?;
    ids.extend(read_on(log)?);
    let name = SHARD.pack(before.epoch + 1, Uuid::now_v7());
    let bytes: Vec<u8> = ids.into_iter().flat_map(u64::to_le_bytes).collect();
    client.put_new(&name, &bytes)?;
    let next = log.next();
    let owner = Uuid::now_v7();
    Ok(Manifest { epoch: 0, owner, floor: next.seq, first: next.number, pack: Some(name), next: next.number })
}

/// Catches: two segments of one number, records that change their places, a reader that begins in the wrong one.
#[test]
fn records_are_numbered_in_one_order_whoever_appends() {
    let client = client(memory());
    let (mut a, mut b) = (log(&client), log(&client));
    for round in 0..40 {
        append(if round % 3 == 0 { &mut a } else { &mut b }, round);
    }
    assert_eq!(counted(&client).unwrap(), (0..40).collect::<Vec<_>>());
    for number in 1..=41 {
        let mut log = log(&client);
        log.go_to(number).unwrap();
        let segment = SegmentRecords { first: number, records: vec![record(number - 1)] };
        let expected = if number <= 40 { Peeked::Segment(segment) } else { Peeked::Nothing };
        assert_eq!(log.peek().unwrap(), expected);
    }
    assert!(matches!(log(&client).go_to(42), Err(Error::Unusable(_))));
    let floor = fold(&client).unwrap().unwrap();
    assert_eq!((floor.floor, floor.first, floor.next), (41, 41, 41));
    assert!(matches!(log(&client).go_to(40), Err(Error::Unusable(_))), "it is below the floor");
    append(&mut log(&client), 40);
    assert_eq!(counted(&client).unwrap(), (0..=40).collect::<Vec<_>>());
}

/// Catches: an upload that its vehicle sends again because the answer to the store's success was lost, and that counts twice.
#[test]
fn a_creation_whose_answer_was_lost_is_found_to_be_ours() {
    struct Deaf(Arc<dyn Bucket>, AtomicBool);
    impl Bucket for Deaf {
        fn create(&self, name: &str, body: &[u8]) -> Result<Created, super::bucket::Failure> {
            let done = self.0.create(name, body);
            let lost = super::bucket::Failure::Unknown("a reset".to_owned());
            if self.1.swap(false, Ordering::Relaxed) { Err(lost) } else { done }
        }
        fn get(
            &self,
            name: &str,
            range: Option<std::ops::Range<u64>>,
        ) -> Result<Option<Vec<u8>>, super::bucket::Failure> {
            self.0.get(name, range)
        }
        fn list(&self, folder: &str) -> Result<Vec<super::bucket::Listed>, super::bucket::Failure> {
            self.0.list(folder)
        }
        fn delete(&self, name: &str) -> Result<(), super::bucket::Failure> {
            self.0.delete(name)
        }
        fn locate(&self, name: &str) -> String {
            self.0.locate(name)
        }
    }
    let deaf = client(Arc::new(Deaf(memory(), AtomicBool::new(true))));
    assert_eq!(deaf.put_new("a", b"ours").unwrap(), Put::Ours);
    assert_eq!(deaf.put_new("a", b"ours").unwrap(), Put::Ours, "taken, by itself");
    assert_eq!(deaf.put_new("a", b"another's").unwrap(), Put::Theirs(b"ours".to_vec()));
}

/// A server stands at a place, others write and fold on, and collection frees its name; then it appends there. Did what it
/// acknowledges count?
fn stalled_append_counts(check: Check, collect: impl Fn(&Client)) -> bool {
    let client = client(memory());
    let (mut stalled, mut others) = (log_with(&client, check), log(&client));
    for of in 0..3 {
        append(&mut others, of);
    }
    read_on(&mut stalled).unwrap();
    for of in 3..6 {
        append(&mut others, of);
    }
    fold(&client).unwrap().unwrap();
    collect(&client);
    let acknowledged = matches!(stalled.append(vec![record(99)]).unwrap(), Appended::Written(_));
    !acknowledged || counted(&client).unwrap().contains(&99)
}

fn swept_whole(client: &Client) {
    let manifest = log(client).chain().known().clone();
    assert_eq!(sweep(client, SHARD, &manifest, LATE).unwrap(), Swept { segments: 6, packs: 0, young: 0 });
}

/// A collector that dies half-way: it has deleted all but one.
fn swept_with_a_hole(client: &Client) {
    for seq in [1, 2, 4, 5, 6] {
        client.delete(&SHARD.segment(seq)).unwrap();
    }
}

/// Rule 1, and what is lost without it.
#[test]
fn a_name_that_was_collected_is_seen_by_the_floor() {
    assert!(stalled_append_counts(Check::Floor, swept_whole));
    assert!(stalled_append_counts(Check::Floor, swept_with_a_hole));
    assert!(!stalled_append_counts(Check::Nothing, swept_whole), "without the rule it is lost");
}

/// Rule 1 for who reads. Catches: an upload that is taken for counted because a stalled server, which did not acknowledge it,
/// left it under a name that nobody reads.
#[test]
fn what_a_stalled_server_left_is_not_read() {
    for (check, sound) in [(Check::Floor, true), (Check::Nothing, false)] {
        let client = client(memory());
        let (mut stalled, mut reader) = (log(&client), log_with(&client, check));
        append(&mut log(&client), 0);
        let newest = fold(&client).unwrap().unwrap();
        sweep(&client, SHARD, &newest, LATE).unwrap();
        assert_eq!(stalled.append(vec![record(99)]).unwrap(), Appended::Passed);
        assert_eq!(reader.peek().unwrap() == Peeked::Passed, sound);
    }
}

/// Rule 2, and what is lost by its substitute.
#[test]
fn the_name_before_it_says_nothing() {
    assert!(stalled_append_counts(Check::Predecessor, swept_whole), "it seems to do");
    assert!(!stalled_append_counts(Check::Predecessor, swept_with_a_hole), "a collector died half-way");
}

/// Rule 1's other half: a floor that is published after the deletion comes too late.
#[test]
fn the_floor_is_published_before_anything_is_deleted() {
    for (publish_first, counts) in [(true, true), (false, false)] {
        let client = client(memory());
        let (mut stalled, mut others) = (log(&client), log(&client));
        append(&mut others, 0);
        let mut folder = log(&client);
        let manifest = next_manifest(&client, &mut folder).unwrap();
        let mut publish = || assert!(folder.chain().publish(manifest.clone()).unwrap());
        if publish_first {
            publish();
        }
        client.delete(&SHARD.segment(1)).unwrap();
        let acknowledged = matches!(stalled.append(vec![record(99)]).unwrap(), Appended::Written(_));
        if !publish_first {
            publish();
        }
        let there = counted(&client).unwrap().contains(&99);
        assert_eq!(!acknowledged || there, counts, "published first: {publish_first}");
    }
}

/// Rule 3: of two who fold at once one is told that it lost. Where manifests are swapped, the floor goes back, and what is
/// acknowledged below it is lost.
#[test]
fn manifests_are_a_chain_and_nothing_is_swapped() {
    for (swapped, counts) in [(false, true), (true, false)] {
        let memory = memory();
        let word = if swapped { "/m/" } else { "nothing" };
        let client = client(Arc::new(Ignoring { inner: memory, word }));
        let (mut stalled, mut others) = (log(&client), log(&client));
        append(&mut others, 0);
        let mut slow = log(&client);
        let early = next_manifest(&client, &mut slow).unwrap();
        read_on(&mut stalled).unwrap();
        append(&mut others, 1);
        let newest = fold(&client).unwrap().unwrap();
        sweep(&client, SHARD, &newest, LATE).unwrap();
        assert_eq!(
            slow.chain().publish(early).unwrap(),
            swapped,
            "it lost the race, and must throw its pack away"
        );
        let acknowledged = matches!(stalled.append(vec![record(99)]).unwrap(), Appended::Written(_));
        let found = counted(&client).unwrap_or_default();
        assert_eq!(
            (!acknowledged || found.contains(&99)) && found.contains(&1),
            counts,
            "swapped: {swapped}"
        );
    }
}

/// Catches: a pack that is swept as an orphan before its slow maker publishes the manifest that names it.
#[test]
fn a_pack_stays_while_a_manifest_may_name_it() {
    let client = client(memory());
    append(&mut log(&client), 0);
    let (mut slow, mut late) = (log(&client), log(&client));
    let manifest = next_manifest(&client, &mut slow).unwrap();
    let other = next_manifest(&client, &mut late).unwrap();
    assert_eq!(sweep(&client, SHARD, &Manifest::initial(), LATE).unwrap(), Swept::default());
    assert!(slow.chain().publish(manifest).unwrap() && !late.chain().publish(other).unwrap());
    let newest = slow.chain().known().clone();
    let swept = sweep(&client, SHARD, &newest, LATE).unwrap();
    assert_eq!(swept, Swept { segments: 1, packs: 1, young: 0 }, "only the one that lost");
    assert_eq!(counted(&client).unwrap(), [0]);
}

/// Rule 4, and its negative controls: stores that lose acknowledged uploads are refused at the start.
#[test]
fn a_store_that_ignores_conditions_is_refused() {
    probe(&client(memory())).unwrap();
    let slow = Failing::around(memory(), 3, 200);
    probe(&client(Arc::new(slow))).unwrap();
    let ignoring = client(Arc::new(Ignoring { inner: memory(), word: "" }));
    let refused = probe(&ignoring).unwrap_err();
    assert!(matches!(&refused, Error::Unusable(reason) if reason.contains("If-None-Match")), "{refused}");
}

/// Catches: servers that start together and each make a cluster, or a key, of their own.
#[test]
fn servers_that_start_together_join_one_cluster() {
    let bucket = memory();
    let joined: Vec<_> = std::thread::scope(|scope| {
        let join = |seed| {
            let failing: Arc<dyn Bucket> = Arc::new(Failing::around(bucket.clone(), seed, 300));
            let patient = super::client::Patience { limit: Duration::from_secs(20), ..Default::default() };
            move || Cluster::join(&Client::new(failing, patient), None).unwrap()
        };
        let all: Vec<_> = (0..4).map(|seed| scope.spawn(join(seed))).collect();
        all.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert!(joined.iter().all(|found| *found == joined[0]), "{joined:?}");
}

/// What all servers of a test have to do, and what they acknowledged.
#[derive(Default)]
struct Drive {
    waiting: Mutex<Vec<u64>>,
    acknowledged: Mutex<HashSet<u64>>,
    over: AtomicBool,
}

/// A server that appends: what it could not acknowledge, another one is asked to.
fn serve(client: &Client, drive: &Drive) -> Result<(), Error> {
    let mut log = SharedLog::open(client.clone(), SHARD, (CLUSTER, Uuid::now_v7()), Check::default())?;
    let manifest = log.chain().known().clone();
    let mut seen: HashSet<u64> = packed(client, &manifest)?.into_iter().collect();
    let mut group: Vec<u64> = Vec::new();
    loop {
        {
            let mut waiting = drive.waiting.lock().unwrap();
            let left = waiting.len().saturating_sub(3);
            group.extend(waiting.drain(left..));
        }
        if group.is_empty() {
            return Ok(());
        }
        let outcome = acknowledge(&mut log, &mut seen, &group);
        match outcome {
            Ok(true) => drive.acknowledged.lock().unwrap().extend(group.drain(..)),
            Ok(false) | Err(_) => drive.waiting.lock().unwrap().append(&mut group),
        }
        if !outcome? {
            // The floor has passed: begin again.
            return Ok(());
        }
    }
}

fn acknowledge(log: &mut SharedLog, seen: &mut HashSet<u64>, group: &[u64]) -> Result<bool, Error> {
    loop {
        seen.extend(read_on(log)?);
        let fresh: Vec<_> = group.iter().filter(|id| !seen.contains(id)).map(|id| record(*id)).collect();
        if fresh.is_empty() {
            // Counted before: what was read was no name that collection had freed.
            return Ok(true);
        }
        match log.append(fresh)? {
            Appended::Written(done) => {
                log.advance(&done);
                seen.extend(group);
                return Ok(true);
            }
            Appended::Behind => {}
            Appended::Passed => return Ok(false),
        }
    }
}

/// A server that folds and collects, and sometimes dies between two deletions.
fn keep(client: &Client, drive: &Drive) {
    while !drive.over.load(Ordering::Relaxed) {
        let published = fold(client);
        if let Ok(Some(manifest)) = published {
            // With a bucket that fails it stops anywhere.
            let _ = sweep(client, SHARD, &manifest, LATE);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Catches: any interleaving of appends, folds, collections, lost answers, stalls and old lists that loses or doubles what was
/// acknowledged. The clients' acknowledgements are the judge.
#[test]
fn a_fleet_loses_nothing_and_doubles_nothing() {
    let uploads = 1500;
    for seed in 0..2 {
        let bucket = memory();
        let drive = Drive { waiting: Mutex::new((0..uploads).collect()), ..Drive::default() };
        let failing = |of: u64| client(Arc::new(Failing::around(bucket.clone(), seed * 100 + of, 60)));
        std::thread::scope(|scope| {
            let servers: Vec<_> = (0..4)
                .map(|of| {
                    let (client, drive) = (failing(of), &drive);
                    scope.spawn(move || {
                        while drive.acknowledged.lock().unwrap().len() < uploads as usize {
                            let _ = serve(&client, drive);
                        }
                    })
                })
                .collect();
            for of in 10..12 {
                let (client, drive) = (failing(of), &drive);
                scope.spawn(move || keep(&client, drive));
            }
            for server in servers {
                server.join().unwrap();
            }
            drive.over.store(true, Ordering::Relaxed);
        });
        let mut times: HashMap<u64, u32> = HashMap::new();
        let found = counted(&client(bucket)).unwrap();
        for id in &found {
            *times.entry(*id).or_default() += 1;
        }
        let acknowledged = drive.acknowledged.into_inner().unwrap();
        let lost: Vec<_> = acknowledged.iter().filter(|id| !times.contains_key(id)).collect();
        let doubled: Vec<_> = times.iter().filter(|(_, times)| **times > 1).collect();
        assert!(lost.is_empty() && doubled.is_empty(), "seed {seed}: lost {lost:?}, doubled {doubled:?}");
        assert_eq!(acknowledged.len(), uploads as usize);
    }
}
