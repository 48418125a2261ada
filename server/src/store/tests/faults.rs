//! The store over a backend that fails in every way: what was acknowledged is folded, once.

use super::super::backend::faulty::ALL;
use super::super::backend::memory::Memory;
use super::super::map::context::Settings;
use super::*;

/// A store in memory whose backend fails, and those who send to it until each upload is acknowledged.
struct Fleet {
    disk: Memory,
    faults: Faults,
    /// `None` while it cannot be opened.
    store: Option<EmbeddedStore>,
    sent: Vec<UploadRecord>,
    /// By number in the journal.
    acknowledged: BTreeMap<u64, Uuid>,
    revoked: HashSet<Uuid>,
    failing: Failing,
}

/// What fails while nothing is being healed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Failing {
    Nothing,
    /// Calls of one kind, in one way.
    Named(Call, Fault),
    Drawn {
        seed: u64,
        per_mille: u64,
    },
}

impl Fleet {
    fn new() -> Self {
        TODAY.set(Some(100));
        let (disk, faults) = (Memory::default(), Faults::default());
        let store = Some(EmbeddedStore::over(disk.open(), settings()).unwrap());
        let (sent, acknowledged, revoked) = (Vec::new(), BTreeMap::new(), HashSet::new());
        let mut fleet = Self { disk, faults, store, sent, acknowledged, revoked, failing: Failing::Nothing };
        fleet.restart();
        fleet
    }

    /// Sends an upload that may be refused.
    fn send(&mut self, mut upload: UploadRecord) {
        // No contributor comes twice: it would count again after a compaction.
        upload.pass.contributor = self.sent.len() as u64;
        self.sent.push(upload.clone());
        self.resend(&upload);
    }

    fn resend(&mut self, upload: &UploadRecord) {
        let Some(store) = &self.store else { return };
        let Ok(Receipt::Counted { epoch } | Receipt::Duplicate { epoch, .. }) = store.commit(upload.clone())
        else {
            return;
        };
        let before = self.acknowledged.insert(epoch, upload.id);
        assert!(before.is_none_or(|id| id == upload.id), "two uploads have number {epoch}");
    }

    /// From now on it fails again.
    fn fail(&self) {
        match self.failing {
            Failing::Nothing => self.faults.heal(),
            Failing::Named(call, fault) => self.faults.name(call, fault),
            Failing::Drawn { seed, per_mille } => self.faults.draw(seed, per_mille),
        }
    }

    /// Drops the store, and opens it again if that succeeds.
    fn restart(&mut self) {
        drop(self.store.take());
        self.store = EmbeddedStore::over(self.faults.around(self.disk.open()), settings()).ok();
    }

    /// As a power cut: who had the disk writes nothing more, and some of what was not durable is lost.
    fn cut_power(&mut self, kept: usize) {
        let _next = self.disk.open();
        drop(self.store.take());
        self.disk.cut_power(|bytes| bytes.min(kept));
        self.restart();
    }

    /// Nothing fails any more, and all that was not acknowledged is sent again.
    fn heal(&mut self) {
        self.faults.heal();
        if self.store.is_none() {
            self.store = Some(EmbeddedStore::over(self.faults.around(self.disk.open()), settings()).unwrap());
        }
        let known: HashSet<_> = self.acknowledged.values().copied().collect();
        for upload in self.sent.clone().iter().filter(|upload| !known.contains(&upload.id)) {
            self.resend(upload);
        }
        assert_eq!(self.acknowledged.len(), self.sent.len());
    }

    /// Takes an upload back; what was compacted stays.
    fn revoke(&mut self, at: usize) {
        self.heal();
        let Some(id) = self.sent.get(at % self.sent.len().max(1)).map(|upload| upload.id) else { return };
        self.fail();
        let mut outcome = self.store.as_ref().unwrap().revoke_upload(id);
        if !matches!(outcome, Ok(_) | Err(Error::Unknown(_))) {
            // It may be in the journal all the same; twice is as good as once.
            self.heal();
            outcome = self.store.as_ref().unwrap().revoke_upload(id);
        }
        if outcome.is_ok() {
            self.revoked.insert(id);
        }
    }

    /// Compacts all that was sent so far, if that does not fail.
    fn compact(&mut self) {
        self.heal();
        let tomorrow = TODAY.get().unwrap() + 1;
        TODAY.set(Some(tomorrow));
        self.fail();
        let _ = self.store.as_ref().unwrap().compact(tomorrow);
    }

    /// Waits until something failed or all is folded.
    fn settle(&self) {
        let Some(store) = &self.store else { return };
        wait_for(store, |p| {
            let folded = p.state == MapStatus::Serving && p.epoch == p.journaled && p.building.is_none();
            folded || self.faults.injected() > 0
        });
    }

    /// Nobody sees half of what is written, or anything damaged.
    fn look(&self) {
        let Some(store) = &self.store else { return };
        let all = i32::MIN..=i32::MAX;
        for zone in store.zones() {
            for info in store.catalog(zone, all.clone(), all.clone()).unwrap_or_default() {
                let tile = store.tile(info.id);
                assert!(!matches!(tile, Err(Error::Damaged { .. })), "{tile:?}");
            }
        }
    }

    fn check(mut self) {
        self.heal();
        for _ in 0..2 {
            let store = self.store.as_ref().unwrap();
            let folded: BTreeMap<_, _> = map(store).into_iter().map(|(id, (_, bytes))| (id, bytes)).collect();
            let by_id = |id: &Uuid| self.sent.iter().find(|upload| upload.id == *id).unwrap().clone();
            let left = self.acknowledged.values().filter(|id| !self.revoked.contains(id));
            let expected = model(&left.map(by_id).collect::<Vec<_>>());
            assert_eq!(folded, expected.into_iter().map(|(id, (_, bytes))| (id, bytes)).collect());
            wait_for(store, |_| store.totals().uploads == self.sent.len() as u64);
            assert_eq!(store.verify(true).unwrap().damage, [""; 0]);
            self.restart();
        }
    }
}

fn settings() -> Settings {
    let usual = options(Path::new("")).settings();
    Settings { segment_bytes: 600, retry: Duration::from_millis(1), ..usual }
}

/// What may happen.
#[derive(Debug, Clone)]
enum Happening {
    Send(UploadRecord),
    Fail(u64, u64),
    Heal,
    Restart,
    CutPower(usize),
    Revoke(usize),
    Compact,
    Look,
}

fn happenings() -> impl Strategy<Value = Vec<Happening>> {
    let fail = (any::<u64>(), prop::sample::select(vec![5, 50, 300]));
    let happening = prop_oneof![
        10 => uploads().prop_map(Happening::Send),
        4 => fail.prop_map(|(seed, per_mille)| Happening::Fail(seed, per_mille)),
        1 => Just(Happening::Heal),
        2 => Just(Happening::Restart),
        2 => (0..400_usize).prop_map(Happening::CutPower),
        1 => (0..100_usize).prop_map(Happening::Revoke),
        1 => Just(Happening::Compact),
        2 => Just(Happening::Look),
    ];
    prop::collection::vec(happening, 4..40)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    // Breaks it: acknowledging before the sync.
    #[test]
    fn what_was_acknowledged_is_folded_once_whatever_fails(happenings in happenings()) {
        let mut fleet = Fleet::new();
        for happening in happenings {
            match happening {
                Happening::Send(upload) => fleet.send(upload),
                Happening::Fail(seed, per_mille) => fleet.failing = Failing::Drawn { seed, per_mille },
                Happening::Heal => {
                    fleet.failing = Failing::Nothing;
                    fleet.heal();
                }
                Happening::Restart => fleet.restart(),
                Happening::CutPower(kept) => fleet.cut_power(kept),
                Happening::Revoke(at) => fleet.revoke(at),
                Happening::Compact => fleet.compact(),
                Happening::Look => fleet.look(),
            }
            fleet.fail();
        }
        fleet.check();
    }
}

/// Every kind of call fails in every way for a while: in the middle of uploads, of a revocation, of a compaction.
#[test]
fn no_call_is_one_that_must_not_fail() {
    let of_tables =
        [Call::Create, Call::Open, Call::Get, Call::Scan, Call::Apply, Call::Flush, Call::Complete];
    let of_tables = of_tables.into_iter().flat_map(|call| [call(TableUse::Served), call(TableUse::Scratch)]);
    let calls = [
        Call::PutObject,
        Call::OpenObject,
        Call::ListObjects,
        Call::DeleteObject,
        Call::ListSegments,
        Call::OpenSegment,
        Call::BeginSegment,
        Call::DeleteSegments,
        Call::Append,
        Call::Sync,
        Call::Cut,
        Call::Read,
        Call::CheckFence,
        Call::Newest,
        Call::Publish,
        Call::SetAside,
        Call::NextNumber,
        Call::Clean,
    ];
    let uploads = some_uploads(9);
    let mut spared = HashSet::new();
    for (call, fault) in calls.into_iter().chain(of_tables).flat_map(|call| ALL.map(|fault| (call, fault))) {
        let mut fleet = Fleet::new();
        fleet.send(uploads[0].clone());
        fleet.compact();
        fleet.settle();
        fleet.failing = Failing::Named(call, fault);
        fleet.fail();
        for (step, group) in uploads[1..].chunks(2).enumerate() {
            for upload in group {
                fleet.send(upload.clone());
            }
            match step {
                1 => fleet.revoke(2),
                2 => fleet.compact(),
                3 => fleet.restart(),
                _ => {}
            }
            fleet.settle();
            fleet.look();
        }
        fleet.cut_power(40);
        if fleet.faults.injected() == 0 {
            spared.insert(call);
        }
        fleet.check();
    }
    // Nothing here is set aside, and scratch tables are written, read through, and dropped.
    let of_scratch = [Call::Open, Call::Get, Call::Flush, Call::Complete].map(|call| call(TableUse::Scratch));
    let never: HashSet<_> = of_scratch.into_iter().chain([Call::SetAside]).collect();
    assert_eq!(spared, never, "the others were made to fail");
}
