//! Lanes: which threads do what, and which of them come first.
//!
//! Localizing outranks all else. It has threads of its own at the process's priority, and so has the vehicles' port, which reads,
//! decodes and refuses. Uploads, readers of the map and operators come last, and so do folding, vetting and preparing tiles,
//! whose threads lower themselves ([`lower`]). A thread of lower priority takes what the others leave, and little beside them.

use std::io;
use std::sync::Arc;

use tokio::runtime::{Builder, Handle, Runtime};
use tokio::task::JoinSet;
use tonic::Status;
use tracing::Instrument;

use crate::grpc::status;

/// By how much all is nicer that nobody waits for on the road. No more: what it holds, a lock or a half-made tile, others may wait
/// for, and on a busy machine uploads must be folded, too.
pub(crate) const BACKGROUND: i32 = 5;

/// Handles of the lanes; the threads end with the last clone.
#[derive(Clone)]
pub struct Lanes {
    /// For alignments. Only so many run as there are compute slots.
    pub localizing: Handle,
    /// For the vehicles' port.
    pub port: Handle,
    /// For uploads, readers and operators.
    pub background: Handle,
    _threads: Arc<Threads>,
}

impl Lanes {
    /// Threads for each lane.
    ///
    /// # Errors
    /// When the system has no threads left.
    pub fn start() -> io::Result<Self> {
        let threads =
            [lane("localize", 1, 0)?, lane("port", cores(), 0)?, lane("background", cores(), BACKGROUND)?];
        let [localizing, port, background] = threads.each_ref().map(|runtime| runtime.handle().clone());
        Ok(Self { localizing, port, background, _threads: Arc::new(Threads(threads.into())) })
    }

    /// One lane for everything: the runtime that this is called in.
    #[must_use]
    pub fn here() -> Self {
        let here = Handle::current();
        let [localizing, port, background] = [here.clone(), here.clone(), here];
        Self { localizing, port, background, _threads: Arc::default() }
    }
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(2, usize::from)
}

/// A runtime whose threads, those for blocking work too, have a name and a priority.
fn lane(name: &str, workers: usize, nice: i32) -> io::Result<Runtime> {
    let mut builder = Builder::new_multi_thread();
    builder
        .worker_threads(workers)
        .thread_name(name)
        .on_thread_start(move || lower(nice))
        .enable_all()
        .build()
}

/// The threads of the lanes.
#[derive(Default)]
struct Threads(Vec<Runtime>);

impl Drop for Threads {
    fn drop(&mut self) {
        // The last clone may go on one of these threads, which cannot wait for itself.
        self.0.drain(..).for_each(Runtime::shutdown_background);
    }
}

/// Makes this thread nicer than the process by so much. Where threads have no priority of their own, nothing happens.
pub fn lower(nice: i32) {
    #[cfg(target_os = "linux")]
    if nice > 0 {
        let own = rustix::process::getpriority_process(None);
        let lowered = own.and_then(|own| rustix::process::setpriority_process(None, (own + nice).min(19)));
        if let Err(error) = lowered {
            tracing::debug!(%error, "a thread keeps its priority");
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}

/// Runs a call on a lane, in the span of its caller; it ends with its caller.
pub(crate) async fn run_on<T: Send + 'static>(
    lane: &Handle,
    call: impl Future<Output = Result<T, Status>> + Send + 'static,
) -> Result<T, Status> {
    let mut calls = JoinSet::new();
    calls.spawn_on(call.in_current_span(), lane);
    match calls.join_next().await {
        Some(Ok(answer)) => answer,
        Some(Err(error)) => Err(status::torn(&error)),
        None => Err(status::gone()),
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    fn nice() -> i32 {
        rustix::process::getpriority_process(None).expect("a thread has a priority")
    }

    /// Catches: work of another lane on the threads that localize, or at their priority.
    #[test]
    fn each_lane_has_threads_of_its_own_priority() {
        let (lanes, own) = (Lanes::start().unwrap(), nice());
        let of = |lane: &Handle| {
            let name = || std::thread::current().name().unwrap_or_default().to_owned();
            let (sender, found) = std::sync::mpsc::channel();
            let blocking = sender.clone();
            lane.spawn(async move { sender.send((name(), nice())) });
            let first = found.recv().unwrap();
            lane.spawn_blocking(move || blocking.send((name(), nice())));
            assert_eq!(found.recv().unwrap(), first, "blocking work is of the same lane");
            first
        };
        assert_eq!(of(&lanes.localizing), ("localize".to_owned(), own));
        assert_eq!(of(&lanes.port), ("port".to_owned(), own));
        assert_eq!(of(&lanes.background), ("background".to_owned(), (own + BACKGROUND).min(19)));
    }

    /// Catches: a call that works on for a caller that is gone.
    #[tokio::test]
    async fn a_call_ends_with_its_caller() {
        let (lanes, held) = (Lanes::start().unwrap(), Arc::new(()));
        let inside = held.clone();
        let call = run_on::<()>(&lanes.background, async move {
            std::future::pending::<()>().await;
            drop(inside);
            Ok(())
        });
        let gone = tokio::time::timeout(std::time::Duration::from_millis(20), call).await;
        assert!(gone.is_err());
        while Arc::strong_count(&held) > 1 {
            tokio::task::yield_now().await;
        }
        assert_eq!(run_on(&lanes.background, async { Ok(7) }).await.unwrap(), 7);
    }
}
