//! Compute slots: alignment takes a core for a while, so only so many run and only so many wait.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use echofix_core::align::Aligner;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::LocateRefusal;

/// How long a refused request is asked to wait.
const RETRY_AFTER: Duration = Duration::from_millis(200);

/// For how long a request that is still being received keeps its place: no caller can hold one by sending slowly.
const ARRIVES_WITHIN: Duration = Duration::from_millis(250);

/// Who would wait longer for a slot is refused at once: by then the answer would be worth little, and those behind it less. So a
/// slow machine, or a busy one, has a short queue.
const WAITS_AT_MOST: Duration = Duration::from_millis(500);

/// Slots with their buffers.
pub(super) struct ComputeSlots {
    threads: usize,
    capacity: usize,
    /// For how long a slot is taken, microseconds; 0 before it is known.
    typical_us: Arc<AtomicU64>,
    arriving: Arc<Mutex<Arrivals>>,
    /// Requests that run or wait.
    admitted: Arc<Semaphore>,
    /// Requests that run.
    running: Arc<Semaphore>,
    aligners: Arc<Mutex<Vec<Aligner>>>,
}

/// A slot, given back when dropped.
pub(super) struct ComputeSlot {
    aligner: Option<Aligner>,
    home: Arc<Mutex<Vec<Aligner>>>,
    since: Instant,
    typical_us: Arc<AtomicU64>,
    _admitted: OwnedSemaphorePermit,
    _running: OwnedSemaphorePermit,
}

impl ComputeSlots {
    pub(super) fn new(threads: usize, queue: usize) -> Self {
        let capacity = threads + queue;
        Self {
            threads,
            capacity,
            typical_us: Arc::default(),
            arriving: Arc::default(),
            admitted: Arc::new(Semaphore::new(capacity)),
            running: Arc::new(Semaphore::new(threads)),
            aligners: Arc::default(),
        }
    }

    /// A place for a request of which only the headers are here; refuses when those that run, wait and arrive leave none.
    pub(super) fn expect(&self) -> Result<Arriving, LocateRefusal> {
        let mut arrivals = lock(&self.arriving);
        let now = Instant::now();
        arrivals.forget_before(now.checked_sub(ARRIVES_WITHIN));
        if arrivals.coming.len() >= self.admitted.available_permits() {
            return Err(self.overloaded());
        }
        self.would_be_soon(arrivals.coming.len())?;
        let number = arrivals.next;
        arrivals.next += 1;
        arrivals.coming.insert((now, number));
        Ok(Arriving { at: (now, number), home: Arc::clone(&self.arriving) })
    }

    /// Refuses when who comes behind those that run and wait, and behind so many that arrive, would wait for too long.
    fn would_be_soon(&self, arriving: usize) -> Result<(), LocateRefusal> {
        let ahead = arriving + self.capacity - self.admitted.available_permits();
        let waits_us = self.typical_us.load(Ordering::Relaxed) * ahead as u64 / self.threads.max(1) as u64;
        let is_soon = ahead < self.threads || Duration::from_micros(waits_us) <= WAITS_AT_MOST;
        if is_soon { Ok(()) } else { Err(self.overloaded()) }
    }

    fn overloaded(&self) -> LocateRefusal {
        LocateRefusal::Overloaded { waiting: self.capacity, retry_after: RETRY_AFTER }
    }

    /// Waits for a slot in order of arrival; refuses at once when too many wait already.
    pub(super) async fn take(&self) -> Result<ComputeSlot, LocateRefusal> {
        self.would_be_soon(0)?;
        let admitted = Arc::clone(&self.admitted).try_acquire_owned().map_err(|_| self.overloaded())?;
        let running = Arc::clone(&self.running).acquire_owned().await;
        let running = running.map_err(|_| LocateRefusal::Ending)?;
        let aligner = lock(&self.aligners).pop().unwrap_or_default();
        let home = Arc::clone(&self.aligners);
        let (since, typical_us) = (Instant::now(), Arc::clone(&self.typical_us));
        Ok(ComputeSlot {
            aligner: Some(aligner),
            home,
            since,
            typical_us,
            _admitted: admitted,
            _running: running,
        })
    }
}

/// Requests that are being received, by when they began.
#[derive(Default)]
struct Arrivals {
    coming: BTreeSet<(Instant, u64)>,
    next: u64,
}

impl Arrivals {
    fn forget_before(&mut self, oldest: Option<Instant>) {
        if let Some(oldest) = oldest {
            self.coming = self.coming.split_off(&(oldest, 0));
        }
    }
}

/// The place of a request that is being received, given back when dropped.
pub struct Arriving {
    at: (Instant, u64),
    home: Arc<Mutex<Arrivals>>,
}

impl Drop for Arriving {
    fn drop(&mut self) {
        lock(&self.home).coming.remove(&self.at);
    }
}

impl ComputeSlot {
    pub(super) fn aligner(&mut self) -> &mut Aligner {
        self.aligner.get_or_insert_default()
    }
}

impl Drop for ComputeSlot {
    fn drop(&mut self) {
        lock(&self.home).extend(self.aligner.take());
        // The mean of the last ones, some sixteen. That two write at once costs one of them.
        let (took, before) =
            (self.since.elapsed().as_micros() as u64, self.typical_us.load(Ordering::Relaxed));
        let mean = if before == 0 { took } else { before - before / 16 + took / 16 };
        self.typical_us.store(mean, Ordering::Relaxed);
    }
}

fn lock<T>(list: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // A panic while holding the lock leaves a list that is still a list.
    list.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn what_exceeds_slots_and_queue_is_refused_at_once() {
        let slots = ComputeSlots::new(1, 1);
        let first = slots.take().await.unwrap();
        let mut second = Box::pin(slots.take());
        assert!(tokio::time::timeout(Duration::from_millis(20), &mut second).await.is_err(), "it waits");
        assert!(matches!(slots.take().await, Err(LocateRefusal::Overloaded { waiting: 2, .. })));
        drop(first);
        let second = second.await.unwrap();
        drop(second);
        assert!(slots.take().await.is_ok());
    }

    /// Catches: a queue of a length that was right for another machine, so that all answers come too late.
    #[tokio::test]
    async fn who_would_wait_for_too_long_is_refused_at_once() {
        let slots = ComputeSlots::new(1, 64);
        let running = slots.take().await.unwrap();
        slots.typical_us.store(300_000, Ordering::Relaxed);
        let next = slots.expect().unwrap();
        assert!(matches!(slots.expect(), Err(LocateRefusal::Overloaded { .. })), "it would wait for 600 ms");
        slots.typical_us.store(5_000, Ordering::Relaxed);
        let many: Vec<_> = std::iter::from_fn(|| slots.expect().ok()).collect();
        assert_eq!(many.len(), 63, "5 ms each");
        slots.typical_us.store(10_000_000, Ordering::Relaxed);
        assert!(slots.take().await.is_err());
        drop((running, next, many));
        assert!(slots.take().await.is_ok(), "nobody is before it, however long it takes");
        assert!(slots.typical_us.load(Ordering::Relaxed) < 10_000_000, "and what is quicker is noticed");
    }

    /// Catches: bodies that are received and decoded for places that are taken, and places that slow callers keep.
    #[tokio::test]
    async fn who_arrives_has_a_place_for_a_moment() {
        let slots = ComputeSlots::new(1, 2);
        let running = slots.take().await.unwrap();
        let arriving = [slots.expect().unwrap(), slots.expect().unwrap()];
        assert!(matches!(slots.expect(), Err(LocateRefusal::Overloaded { waiting: 3, .. })));
        drop(running);
        let third = slots.expect().unwrap();
        assert!(slots.expect().is_err());
        drop((third, arriving));
        let slow: Vec<_> = (0..3).map(|_| slots.expect().unwrap()).collect();
        assert!(slots.expect().is_err());
        tokio::time::sleep(ARRIVES_WITHIN * 2).await;
        assert!(slots.expect().is_ok(), "they arrive too slowly");
        drop(slow);
    }

    #[tokio::test]
    async fn a_request_that_hangs_up_leaves_the_queue() {
        let slots = ComputeSlots::new(1, 1);
        let _first = slots.take().await.unwrap();
        let hung_up = tokio::time::timeout(Duration::from_millis(5), slots.take()).await;
        assert!(hung_up.is_err());
        let waits = tokio::time::timeout(Duration::from_millis(5), slots.take()).await;
        assert!(waits.is_err(), "there is room in the queue again");
    }
}
