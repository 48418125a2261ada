//! Faults around any backend, for tests: errors, delays, answers that are lost, torn writes, old lists.
//!
//! They are drawn from a seed, the kind of call, and how often it was made: the same calls fail the same way again. Or a
//! test says which calls fail.

mod files;
mod table;

use std::collections::HashMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use siphasher::sip::SipHasher24;

use super::Backend;
use super::tables::TableUse;
use crate::store::api::Error;

/// What is asked of a backend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(in crate::store) enum Call {
    PutObject,
    OpenObject,
    ListObjects,
    DeleteObject,
    ListSegments,
    OpenSegment,
    BeginSegment,
    DeleteSegments,
    Append,
    Sync,
    Cut,
    Read,
    CheckFence,
    Newest,
    Publish,
    SetAside,
    Create(TableUse),
    Open(TableUse),
    NextNumber,
    Clean,
    Get(TableUse),
    Scan(TableUse),
    Apply(TableUse),
    Flush(TableUse),
    Complete(TableUse),
}

/// How a call fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) enum Fault {
    /// It is not done.
    Error,
    /// It is done, and reported as failed.
    LostAnswer,
    /// It takes its time.
    Delay,
    /// A write is half done and reported as failed; any other call is not done.
    Torn,
    /// A list is as it was when it was last made; any other call is well.
    Stale,
}

/// Every way to fail.
pub(in crate::store) const ALL: [Fault; 5] =
    [Fault::Error, Fault::LostAnswer, Fault::Delay, Fault::Torn, Fault::Stale];
const DELAY: Duration = Duration::from_millis(1);

/// Which calls fail from now on. Clones are of the same faults.
#[derive(Clone, Default)]
pub(in crate::store) struct Faults(Arc<Mutex<Plan>>);

#[derive(Default)]
struct Plan {
    /// Every such call fails so.
    named: Option<(Call, Fault)>,
    /// Seed, and how many of a thousand calls fail.
    drawn: Option<(u64, u64)>,
    made: HashMap<Call, u64>,
    /// How often a call failed, or was late or old.
    injected: u64,
}

impl Faults {
    /// Lets every call of a kind fail.
    pub(in crate::store) fn name(&self, call: Call, fault: Fault) {
        self.plan().named = Some((call, fault));
    }

    /// Lets some of all calls fail.
    pub(in crate::store) fn draw(&self, seed: u64, per_mille: u64) {
        self.plan().drawn = Some((seed, per_mille));
    }

    /// From now on nothing fails.
    pub(in crate::store) fn heal(&self) {
        let mut plan = self.plan();
        (plan.named, plan.drawn) = (None, None);
    }

    /// How often something failed.
    pub(in crate::store) fn injected(&self) -> u64 {
        self.plan().injected
    }

    /// A backend whose calls fail so.
    pub(in crate::store) fn around(&self, backend: Backend) -> Backend {
        let objects = Arc::new(files::FaultyObjects::new(backend.objects, self.clone()));
        let segments = Arc::new(files::FaultySegments::new(backend.segments, self.clone()));
        let rest = Arc::new(files::FaultyOwner::new(backend.manifests, backend.fence, self.clone()));
        let tables = Arc::new(table::FaultyTables::new(backend.tables, self.clone()));
        Backend { objects, segments, manifests: rest.clone(), tables, fence: rest, ..backend }
    }

    /// The fault of the next such call.
    fn next(&self, call: Call) -> Option<Fault> {
        let mut plan = self.plan();
        let made = plan.made.entry(call).or_default();
        *made += 1;
        let made = *made;
        let drawn = plan.drawn.and_then(|(seed, per_mille)| {
            let mut hasher = SipHasher24::new_with_keys(seed, made);
            std::hash::Hash::hash(&call, &mut hasher);
            let word = std::hash::Hasher::finish(&hasher);
            (word % 1000 < per_mille).then(|| ALL[(word / 1000) as usize % ALL.len()])
        });
        let named = plan.named.filter(|(named, _)| *named == call).map(|(_, fault)| fault);
        let fault = named.or(drawn);
        plan.injected += u64::from(fault.is_some());
        fault
    }

    /// A call that may fail, but not half-way.
    fn call<T, E: From<Injected>>(&self, call: Call, work: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let fault = self.next(call);
        with(fault, work)
    }

    fn plan(&self) -> MutexGuard<'_, Plan> {
        self.0.lock().expect("nothing panics while it holds this")
    }
}

/// Work under a fault that is not half-way.
fn with<T, E: From<Injected>>(fault: Option<Fault>, work: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
    match fault {
        None | Some(Fault::Stale) => work(),
        Some(Fault::Delay) => {
            std::thread::sleep(DELAY);
            work()
        }
        Some(Fault::Error | Fault::Torn) => Err(Injected.into()),
        Some(Fault::LostAnswer) => work().and(Err(Injected.into())),
    }
}

/// The failure of a call.
struct Injected;

impl From<Injected> for io::Error {
    fn from(_: Injected) -> Self {
        Self::other("the test lets this fail")
    }
}

impl From<Injected> for Error {
    fn from(injected: Injected) -> Self {
        Self::Io { doing: "a call of the backend", source: injected.into() }
    }
}
