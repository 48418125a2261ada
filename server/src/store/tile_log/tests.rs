//! The log against a map in memory, over restarts and torn writes.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;

type Model = BTreeMap<Vec<u8>, Vec<u8>>;

fn open(dir: &Path) -> TileLog {
    TileLog::open(dir, Uuid::nil()).unwrap()
}

fn all(log: &TileLog) -> Model {
    log.keys(&[]).into_iter().map(|key| (key.clone(), log.get(&key).unwrap().unwrap())).collect()
}

fn disk_use(dir: &Path) -> u64 {
    fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum()
}

/// Bytes of the kind that nobody has seen before.
fn value(salt: u64, length: usize) -> Vec<u8> {
    (0..length as u64).map(|at| (salt.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (at % 50)) as u8).collect()
}

#[derive(Debug, Clone)]
enum Step {
    Put(BTreeMap<u8, usize>),
    Reopen,
    /// A crash in the middle of a put: so many of its bytes in a thousand are there.
    Torn(BTreeMap<u8, usize>, u64),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    // Some larger than a file, so that a few puts fill it and cleaning begins.
    let length = || prop_oneof![0..100_usize, 50_000..400_000_usize];
    let batch = || prop::collection::btree_map(0..12_u8, length(), 1..5);
    let step = prop_oneof![
        6 => batch().prop_map(Step::Put),
        1 => Just(Step::Reopen),
        1 => (batch(), 0..1000_u64).prop_map(|(batch, share)| Step::Torn(batch, share)),
    ];
    prop::collection::vec(step, 1..40)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    // Breaks it: cleaning a file without moving what counts, or without the newest of two values; reading a torn
    // frame; writing behind one.
    #[test]
    fn what_was_put_is_there_and_little_else(steps in steps()) {
        let dir = tempfile::tempdir().unwrap();
        let mut log = TileLog::create(dir.path(), Uuid::nil()).unwrap();
        let mut model = Model::new();
        for (salt, step) in (1..).zip(steps) {
            let entries = |batch: &BTreeMap<u8, usize>| -> Vec<Entry> {
                batch.iter().map(|(key, length)| (vec![*key], value(salt + u64::from(*key), *length))).collect()
            };
            match step {
                Step::Put(batch) => {
                    log.put(&entries(&batch)).unwrap();
                    model.extend(entries(&batch));
                }
                Step::Reopen => log = open(dir.path()),
                Step::Torn(batch, share) => {
                    let (number, length) = { let newest = log.paused(); (newest.number, newest.length) };
                    let (bytes, _) = frame::encode(number, length, &entries(&batch)).unwrap();
                    let torn = &bytes[..(bytes.len() as u64 * share / 1000) as usize];
                    log.paused().file.write_all_at(torn, length).unwrap();
                    log = open(dir.path());
                }
            }
            prop_assert_eq!(log.keys(&[]), model.keys().cloned().collect::<Vec<_>>());
            let live: usize = model.values().map(|value| value.len() + 9).sum();
            let most = live as u64 * 3 / 2 + log.places().file_bytes() + HEADER as u64;
            prop_assert!(disk_use(dir.path()) <= most, "{} for {live}", disk_use(dir.path()));
        }
        prop_assert!(all(&log) == model);
        prop_assert!(all(&open(dir.path())) == model);
    }
}

/// Breaks it: going on behind damage in a file that was synced long ago.
#[test]
fn damage_of_an_older_file_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let log = TileLog::create(dir.path(), Uuid::nil()).unwrap();
    for key in 0..3 {
        log.put(&[(vec![key], value(7, 4 << 20))]).unwrap();
    }
    drop(log);
    let first = path(dir.path(), 1);
    let good = fs::read(&first).unwrap();
    for at in [0, 9, HEADER, HEADER + 5, good.len() - 1] {
        let mut bad = good.clone();
        bad[at] ^= 4;
        fs::write(&first, bad).unwrap();
        assert!(matches!(TileLog::open(dir.path(), Uuid::nil()), Err(Error::Damaged { .. })), "byte {at}");
    }
    fs::write(&first, &good).unwrap();
    assert_eq!(open(dir.path()).keys(&[]).len(), 3);
    assert!(
        matches!(TileLog::open(dir.path(), Uuid::max()), Err(Error::Damaged { .. })),
        "another journal's"
    );
    fs::write(dir.path().join("notes.txt"), "mine").unwrap();
    assert!(matches!(TileLog::open(dir.path(), Uuid::nil()), Err(Error::Damaged { .. })), "a stray file");
}

#[test]
fn a_file_whose_beginning_a_crash_cut_short_is_begun_again() {
    let dir = tempfile::tempdir().unwrap();
    let log = TileLog::create(dir.path(), Uuid::nil()).unwrap();
    log.put(&[(vec![1], vec![1])]).unwrap();
    drop(log);
    for length in [0, HEADER - 1] {
        fs::write(path(dir.path(), 2), &frame::header(Uuid::nil(), 2)[..length]).unwrap();
        let log = open(dir.path());
        log.put(&[(vec![2], vec![length as u8])]).unwrap();
        assert_eq!(all(&open(dir.path())).len(), 2);
    }
}

/// Breaks it: removing a file before its values have moved, or looking for a value where it was.
#[test]
fn readers_always_find_a_whole_value_while_files_are_cleaned() {
    let dir = tempfile::tempdir().unwrap();
    let log = TileLog::create(dir.path(), Uuid::nil()).unwrap();
    let whole = |salt: u8| vec![salt; 300_000];
    log.put(&(0..8).map(|key| (vec![key], whole(0))).collect::<Vec<_>>()).unwrap();
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
                    for key in 0..8 {
                        let value = log.get(&[key]).unwrap().unwrap();
                        assert!(value == whole(value[0]));
                    }
                }
            });
        }
        for salt in 0..200 {
            log.put(&[(vec![salt % 8], whole(salt))]).unwrap();
        }
        done.store(true, std::sync::atomic::Ordering::Relaxed);
    });
}
