//! Compute slots: alignment takes a core for a while, so only so many run and only so many wait.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use echofix_core::align::Aligner;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::LocateRefusal;

/// How long a refused request is asked to wait.
const RETRY_AFTER: Duration = Duration::from_millis(200);

/// Slots with their buffers.
pub(super) struct ComputeSlots {
    capacity: usize,
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
    _admitted: OwnedSemaphorePermit,
    _running: OwnedSemaphorePermit,
}

impl ComputeSlots {
    pub(super) fn new(threads: usize, queue: usize) -> Self {
        let capacity = threads + queue;
        Self {
            capacity,
            admitted: Arc::new(Semaphore::new(capacity)),
            running: Arc::new(Semaphore::new(threads)),
            aligners: Arc::default(),
        }
    }

    /// Waits for a slot in order of arrival; refuses at once when too many wait already.
    pub(super) async fn take(&self) -> Result<ComputeSlot, LocateRefusal> {
        let overloaded = |_| LocateRefusal::Overloaded { waiting: self.capacity, retry_after: RETRY_AFTER };
        let admitted = Arc::clone(&self.admitted).try_acquire_owned().map_err(overloaded)?;
        let running = Arc::clone(&self.running).acquire_owned().await;
        let running = running.map_err(|_| LocateRefusal::Ending)?;
        let aligner = lock(&self.aligners).pop().unwrap_or_default();
        let home = Arc::clone(&self.aligners);
        Ok(ComputeSlot { aligner: Some(aligner), home, _admitted: admitted, _running: running })
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
    }
}

fn lock(aligners: &Mutex<Vec<Aligner>>) -> std::sync::MutexGuard<'_, Vec<Aligner>> {
    // A panic while holding the lock leaves a list that is still a list.
    aligners.lock().unwrap_or_else(PoisonError::into_inner)
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
