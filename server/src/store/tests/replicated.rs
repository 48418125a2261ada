//! Several servers that share a map in a bucket, against one that has the same journal for itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use crate::store::object::body;
use crate::store::object::bucket::Bucket;
use crate::store::object::client::{Client, Patience};
use crate::store::object::names::Shard;
use crate::store::object::testing::{Failing, Switched, client, memory};
use crate::store::replicated::{Pace, ReplicatedStore};

const PACE: Pace = Pace {
    poll: Duration::from_millis(2),
    keep: Duration::from_millis(5),
    age: Duration::ZERO,
    announce: Duration::from_millis(20),
};

struct Replica {
    store: ReplicatedStore,
    dir: tempfile::TempDir,
}

fn join(client: &Client) -> Replica {
    let dir = tempfile::tempdir().unwrap();
    let store = ReplicatedStore::over(client, &options(dir.path()), PACE).unwrap();
    Replica { store, dir }
}

impl Replica {
    /// Ends it, and starts it on what it left.
    fn restarted(self, client: &Client) -> Self {
        drop(self.store);
        let store = ReplicatedStore::over(client, &options(self.dir.path()), PACE).unwrap();
        Self { store, dir: self.dir }
    }

    /// The map, once it shows all up to an epoch.
    fn map_of(&self, epoch: u64) -> BTreeMap<TileId, (u64, Vec<u8>)> {
        wait_for(&self.store.copy, |progress| progress.journaled >= epoch);
        map(&self.store.copy)
    }
}

/// Tiles without their versions: a replica that begins anew behind a control gives all of them the control's number, and so
/// newer versions to the same bytes.
fn tiles(map: BTreeMap<TileId, (u64, Vec<u8>)>) -> BTreeMap<TileId, Vec<u8>> {
    map.into_iter().map(|(id, (_, tile))| (id, tile)).collect()
}

fn epoch(receipt: &Receipt) -> u64 {
    match receipt {
        Receipt::Counted { epoch } | Receipt::Duplicate { epoch, .. } => *epoch,
    }
}

/// What a server of its own makes of the journal that a replica has.
fn embedded(replica: &Replica) -> BTreeMap<TileId, (u64, Vec<u8>)> {
    let mut archive = Vec::new();
    replica.store.backup(&mut archive).unwrap();
    let dir = tempfile::tempdir().unwrap();
    unpack(&archive, dir.path());
    map(&open(dir.path()))
}

/// Unpacks a backup.
fn unpack(mut archive: &[u8], into: &Path) {
    while let Some((header, rest)) = archive.split_at_checked(512).filter(|(header, _)| header[0] != 0) {
        let text = |from: usize, to: usize| {
            std::str::from_utf8(&header[from..to]).unwrap().trim_end_matches('\0').to_owned()
        };
        let length = usize::from_str_radix(&text(124, 135), 8).unwrap();
        let path = into.join(text(0, 100));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, &rest[..length]).unwrap();
        archive = &rest[length.div_ceil(512) * 512..];
    }
}

/// Catches: replicas whose maps, versions or lineages differ, from each other or from a server that has the journal alone;
/// and a start, warm or cold, that serves a map without what was acknowledged before.
#[test]
fn replicas_have_the_map_of_one_server() {
    let client = client(memory());
    let mut replicas: Vec<_> = (0..3).map(|_| join(&client)).collect();
    let uploads = some_uploads(40);
    let mut last = 0;
    for (at, upload) in uploads.iter().enumerate() {
        let receipt = replicas[at * 7 % 3].store.commit(upload.clone()).unwrap();
        assert_eq!(epoch(&receipt), at as u64 + 1);
        last = epoch(&receipt);
        if at == 20 {
            let one = replicas.remove(1).restarted(&client);
            assert!(one.store.progress().borrow().journaled >= 21, "it begins where the bucket is");
            replicas.insert(1, one);
        }
    }
    let expected = model(&uploads);
    for replica in &replicas {
        assert_eq!(replica.map_of(last), expected);
        assert_eq!(replica.store.lineage(), replicas[0].store.lineage());
        assert_eq!(replica.store.contributor("car-1"), replicas[0].store.contributor("car-1"));
        assert_eq!(replica.store.totals(), replicas[0].store.totals());
    }
    let cold = join(&client);
    assert_eq!(cold.store.progress().borrow().journaled, last);
    assert_eq!(cold.map_of(last), expected);
    assert_eq!(embedded(&cold), expected);
}

/// Catches: an upload that is sent again to another replica, and counts twice.
#[test]
fn an_upload_counts_once_whichever_replica_gets_it() {
    let client = client(memory());
    let replicas: Vec<_> = (0..3).map(|_| join(&client)).collect();
    for upload in some_uploads(15) {
        let send = |replica: &Replica| replica.store.commit(upload.clone()).unwrap();
        let send = &send;
        let receipts: Vec<_> = std::thread::scope(|scope| {
            let twice = replicas.iter().chain(&replicas);
            let all: Vec<_> = twice.map(|replica| scope.spawn(move || send(replica))).collect();
            all.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        let counted = receipts.iter().filter(|receipt| matches!(receipt, Receipt::Counted { .. })).count();
        assert_eq!(counted, 1, "{receipts:?}");
        assert!(receipts.iter().all(|receipt| epoch(receipt) == epoch(&receipts[0])), "{receipts:?}");
    }
    for replica in &replicas {
        replica.map_of(15);
        assert_eq!(replica.store.totals().uploads, 15);
    }
}

/// Catches: a decision of one operator that other replicas do not know, or apply in another order.
#[test]
fn what_one_replica_decides_holds_for_all() {
    let client = client(memory());
    let (a, b) = (join(&client), join(&client));
    let uploads = some_uploads(12);
    uploads[..10].iter().for_each(|upload| drop(a.store.commit(upload.clone()).unwrap()));
    b.map_of(10);
    let revoked = b.store.revoke_upload(uploads[3].id).unwrap();
    a.map_of(revoked);
    let rolled = a.store.rollback(8).unwrap();
    b.map_of(rolled);
    let last = epoch(&b.store.commit(uploads[10].clone()).unwrap());
    assert_eq!((revoked, rolled, last), (11, 12, 13));
    assert_eq!(a.map_of(last), b.map_of(last));
    assert_eq!(a.store.history(9), b.store.history(9));
    let cold = join(&client);
    assert!(tiles(cold.map_of(last)) == tiles(a.map_of(last)), "the same tiles, folded anew");
    assert!(cold.store.verify(true).unwrap().damage.is_empty());
}

/// Catches: a compaction after which the bucket keeps what was to be forgotten, or lacks what a new replica needs.
#[test]
fn what_is_compacted_goes_from_the_bucket_and_new_replicas_begin_behind_it() {
    let bucket = memory();
    let client = client(bucket.clone());
    let (a, b) = (join(&client), join(&client));
    let uploads = some_uploads(12);
    TODAY.set(Some(20_000));
    uploads[..8].iter().for_each(|upload| drop(a.store.commit(upload.clone()).unwrap()));
    TODAY.set(Some(20_005));
    uploads[8..].iter().for_each(|upload| drop(a.store.commit(upload.clone()).unwrap()));
    b.map_of(12);
    let before = a.map_of(12);
    let control = b.store.compact(20_003).unwrap().unwrap();
    let after = a.map_of(control);
    assert_eq!(after.keys().collect::<Vec<_>>(), before.keys().collect::<Vec<_>>());
    let deadline = Instant::now() + Duration::from_secs(20);
    let left = || bucket.list(&Shard(0).journal()).unwrap().len();
    // Each upload was a segment; the four that are not compacted and the control stay.
    while left() > 5 {
        assert!(Instant::now() < deadline, "{} segments are left", left());
        std::thread::sleep(Duration::from_millis(2));
    }
    let cold = join(&client);
    assert!(tiles(cold.map_of(control)) == tiles(b.map_of(control)));
    assert_eq!(cold.store.totals().uploads, 12);
    let warm = a.restarted(&client);
    let last = epoch(&cold.store.commit(some_uploads(13)[12].clone()).unwrap());
    assert!(tiles(warm.map_of(last)) == tiles(cold.map_of(last)));
    assert_eq!(left(), 6);
}

/// Catches: an outage that loses what was acknowledged, stops fixes, or is not told; and one that uploads wait for.
#[test]
fn while_the_bucket_is_away_the_map_is_read_and_uploads_are_refused() {
    let off = Arc::new(AtomicBool::new(false));
    let bucket = Arc::new(Switched { inner: memory(), off: off.clone() });
    let client = client(bucket);
    let replica = join(&client);
    let uploads = some_uploads(6);
    uploads[..3].iter().for_each(|upload| drop(replica.store.commit(upload.clone()).unwrap()));
    let before = replica.map_of(3);
    off.store(true, Ordering::Relaxed);
    let refused = replica.store.commit(uploads[3].clone()).unwrap_err();
    assert!(matches!(refused, Error::Io { .. }), "{refused}");
    wait_for(&replica.store.copy, |progress| progress.refusing);
    assert_eq!(map_of_now(&replica.store.copy), before);
    assert!(replica.store.hang().is_none());
    off.store(false, Ordering::Relaxed);
    wait_for(&replica.store.copy, |progress| !progress.refusing);
    uploads[3..].iter().for_each(|upload| drop(replica.store.commit(upload.clone()).unwrap()));
    assert_eq!(replica.map_of(6), model(&uploads));
}

/// Catches: requests that fail, answers that are lost, old lists and stalls that lose or double what was acknowledged, while
/// several replicas write, fold, compact and collect.
#[test]
fn replicas_over_a_failing_bucket_lose_nothing() {
    let bucket = memory();
    let failing = |seed| -> Client {
        let bucket: Arc<dyn Bucket> = Arc::new(Failing::around(bucket.clone(), seed, 100));
        let ms = Duration::from_millis;
        Client::new(bucket, Patience { pause: ms(1), longest: ms(2), limit: ms(60) })
    };
    let patient = client(bucket.clone());
    let replicas: Vec<_> = (0..3)
        .map(|seed| {
            let client = failing(seed);
            loop {
                let dir = tempfile::tempdir().unwrap();
                if let Ok(store) = ReplicatedStore::over(&client, &options(dir.path()), PACE) {
                    break Replica { store, dir };
                }
            }
        })
        .collect();
    let uploads = some_uploads(60);
    std::thread::scope(|scope| {
        for (at, part) in uploads.chunks(20).enumerate() {
            let replicas = &replicas;
            scope.spawn(move || {
                for (try_at, upload) in part.iter().enumerate() {
                    // Another replica is asked after each failure.
                    let deadline = Instant::now() + Duration::from_secs(30);
                    let mut asked = at + try_at;
                    while let Err(error) = replicas[asked % 3].store.commit(upload.clone()) {
                        assert!(Instant::now() < deadline, "{error}");
                        std::thread::sleep(Duration::from_millis(1));
                        asked += 1;
                    }
                }
            });
        }
    });
    let cold = join(&patient);
    let expected = cold.map_of(60);
    assert_eq!(cold.store.totals().uploads, 60, "each counts once");
    for replica in &replicas {
        assert_eq!(replica.map_of(60), expected);
        assert_eq!(replica.store.progress().borrow().journaled, 60);
    }
    assert_eq!(embedded(&cold), expected);
}

/// Catches: two maps that are mixed up because a data directory is given to another bucket.
#[test]
fn a_directory_of_another_map_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let own = open(dir.path());
    commit_all(&own, &some_uploads(3));
    drop(own);
    let refused = ReplicatedStore::over(&client(memory()), &options(dir.path()), PACE).err().unwrap();
    assert!(matches!(&refused, Error::Unusable(reason) if reason.contains("another map")), "{refused}");
    assert_eq!(open(dir.path()).totals().uploads, 3, "and left as it is");
}

/// Catches: a directory that is begun anew over one whose journal lies on a volume that is not mounted, or over somebody
/// else's files.
#[test]
fn a_directory_that_lost_its_journal_or_is_no_stores_is_not_begun() {
    let (dir, bucket) = (tempfile::tempdir().unwrap(), client(memory()));
    drop(ReplicatedStore::over(&bucket, &options(dir.path()), PACE).unwrap());
    let key = std::fs::read(dir.path().join("key")).unwrap();
    std::fs::rename(dir.path().join("journal"), dir.path().join("elsewhere")).unwrap();
    let refused = ReplicatedStore::over(&bucket, &options(dir.path()), PACE).err().unwrap();
    assert!(matches!(&refused, Error::Unusable(reason) if reason.contains("no journal")), "{refused}");
    assert_eq!(std::fs::read(dir.path().join("key")).unwrap(), key, "and left as it is");
    std::fs::rename(dir.path().join("elsewhere"), dir.path().join("journal")).unwrap();
    drop(ReplicatedStore::over(&bucket, &options(dir.path()), PACE).unwrap());
    let foreign = tempfile::tempdir().unwrap();
    std::fs::write(foreign.path().join("thesis.tex"), "chapter 1").unwrap();
    let refused = ReplicatedStore::over(&bucket, &options(foreign.path()), PACE).err().unwrap();
    assert!(refused.to_string().contains("thesis.tex"), "{refused}");
}

/// Catches: a map that changes, or loses its compacted part or its contributors' names, on its way into a bucket; and one that
/// is brought into a bucket of another.
#[test]
fn a_directory_is_brought_into_a_bucket_as_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let uploads = some_uploads(14);
    TODAY.set(Some(20_000));
    let own = open(dir.path());
    commit_all(&own, &uploads[..5]);
    TODAY.set(Some(20_005));
    commit_all(&own, &uploads[5..10]);
    own.compact(20_003).unwrap().unwrap();
    let (expected, hash) = (tiles(map(&own)), own.contributor("car-1"));
    let bucket = client(memory());
    let shared = SharedMap::over(bucket.clone());
    assert!(matches!(shared.migrate(dir.path()), Err(Error::InUse(_))));
    drop(own);
    for _ in 0..2 {
        assert_eq!(shared.migrate(dir.path()).unwrap(), 11, "and again is no harm");
    }
    let replica = join(&bucket);
    assert!(tiles(replica.map_of(11)) == expected);
    assert_eq!((replica.store.contributor("car-1"), replica.store.totals().uploads), (hash, 10));
    replica.store.commit(uploads[11].clone()).unwrap();
    let status = shared.status().unwrap();
    assert_eq!((status.newest, status.compacted, status.orphans, status.manifest), (12, 5, 0, 1));
    let verified = shared.verify().unwrap();
    assert_eq!((verified.records, verified.damage), (7, Vec::<String>::new()));
    assert!(verified.checkpoint_tiles > 0);
    let other = tempfile::tempdir().unwrap();
    commit_all(&open(other.path()), &uploads[..1]);
    assert!(matches!(shared.migrate(other.path()), Err(Error::Unusable(_))));
}

/// Catches: damage in a bucket that is not seen, or by which a service starts all the same.
#[test]
fn a_damaged_segment_is_seen() {
    let bucket = memory();
    let client = client(bucket.clone());
    let replica = join(&client);
    for upload in some_uploads(3) {
        replica.store.commit(upload).unwrap();
    }
    let name = Shard(0).segment(2);
    let mut bytes = client.get(&name).unwrap().unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    client.delete(&name).unwrap();
    client.put_new(&name, &bytes).unwrap();
    let damage = SharedMap::over(client.clone()).verify().unwrap().damage;
    assert!(damage.len() == 1 && damage[0].contains(&name), "{damage:?}");
    let dir = tempfile::tempdir().unwrap();
    let refused = ReplicatedStore::over(&client, &options(dir.path()), PACE).err().unwrap();
    assert!(matches!(refused, Error::Damaged { .. }), "{refused}");
}

/// The same rules over a real store. `AWS_*` and `ECHOFIX_STORE_URL` name it; its bucket is written to.
#[test]
#[ignore = "needs an S3-compatible object store: see tests/s3/seaweedfs"]
fn replicas_over_a_real_object_store_have_one_map() {
    let url = std::env::var("ECHOFIX_STORE_URL").expect("ECHOFIX_STORE_URL names a bucket");
    let url = format!("{}/{}", url.trim_end_matches('/'), Uuid::now_v7());
    let join = || {
        let dir = tempfile::tempdir().unwrap();
        let store = ReplicatedStore::open(&url, &options(dir.path())).unwrap();
        Replica { store, dir }
    };
    let replicas: Vec<_> = (0..3).map(|_| join()).collect();
    let uploads: Vec<_> = (0..200_u128)
        .map(|at| UploadRecord { id: Uuid::from_u128(at), ..some_uploads(20)[at as usize % 20].clone() })
        .collect();
    let began = Instant::now();
    std::thread::scope(|scope| {
        for (at, part) in uploads.chunks(25).enumerate() {
            let replicas = &replicas;
            scope.spawn(move || {
                for upload in part {
                    // Twice, to two replicas: it counts once.
                    let first = replicas[at % 3].store.commit(upload.clone()).unwrap();
                    let again = replicas[(at + 1) % 3].store.commit(upload.clone()).unwrap();
                    assert!(matches!(again, Receipt::Duplicate { .. }), "{again:?}");
                    assert_eq!(epoch(&first), epoch(&again));
                }
            });
        }
    });
    let took = began.elapsed();
    let alone = Instant::now();
    for at in 1000..1050_u128 {
        let upload = UploadRecord { id: Uuid::from_u128(at), ..uploads[0].clone() };
        replicas[0].store.commit(upload).unwrap();
    }
    let each = alone.elapsed() / 50;
    let status = SharedMap::at(&url).unwrap().status().unwrap();
    eprintln!(
        "200 uploads, each to two of three replicas, by 8 at once: {took:?}; alone {each:?} each; {status:?}"
    );
    let cold = join();
    let expected = cold.map_of(250);
    assert_eq!(cold.store.totals().uploads, 250);
    assert!(replicas.iter().all(|replica| replica.map_of(250) == expected));
    assert!(embedded(&cold) == expected);
    assert!(SharedMap::at(&url).unwrap().verify().unwrap().damage.is_empty());
}

/// Catches: a replica that others do not come to know, one that is sent to after its end, and one that is taken for alive since
/// its announcement was left.
#[test]
fn replicas_know_each_other_while_they_live() {
    let client = client(memory());
    let join = |name: &str| {
        let dir = tempfile::tempdir().unwrap();
        let options = Options { announce: Some(format!("http://{name}:1")), ..options(dir.path()) };
        let store = ReplicatedStore::over(&client, &options, PACE).unwrap();
        Replica { store, dir }
    };
    let known = |replica: &Replica, names: &[&str]| {
        let living = replica.store.replicas().unwrap();
        let names: Vec<_> = names.iter().map(|name| format!("http://{name}:1")).collect();
        let began = Instant::now();
        while *living.borrow() != names {
            assert!(began.elapsed() < Duration::from_secs(30), "{:?}, and not {names:?}", living.borrow());
            std::thread::sleep(Duration::from_millis(2));
        }
    };
    // As a replica that was killed leaves it.
    let left = body::wrap(*b"EFN\x01", b"http://gone:1");
    client.put_new(&Shard(0).announcement(Uuid::now_v7(), 7), &left).unwrap();
    client.put_new(&Shard(0).announcement(Uuid::now_v7(), 7), b"damaged").unwrap();
    let (a, b, c) = (join("a"), join("b"), join("c"));
    for replica in [&a, &b, &c] {
        known(replica, &["a", "b", "c"]);
    }
    drop(b);
    known(&a, &["a", "c"]);
    known(&c, &["a", "c"]);
    let b = join("b");
    known(&c, &["a", "b", "c"]);
    drop((a, b));
    known(&c, &["c"]);
    let silent = ReplicatedStore::over(&client, &options(tempfile::tempdir().unwrap().path()), PACE).unwrap();
    assert!(silent.replicas().is_none());
    // What was left is deleted in the end.
    let began = Instant::now();
    while client.list(&Shard(0).announcements()).unwrap().len() > 1 {
        assert!(began.elapsed() < Duration::from_secs(30));
        std::thread::sleep(Duration::from_millis(20));
    }
}
