//! One instance of sled, opened and closed so that neither can stop the service.

use std::fs::{File, TryLockError};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::store::api::Error;

/// How long a dropped instance may take to let go.
const LOCK_WAIT: Duration = Duration::from_secs(10);
/// How long an instance may take to close. All of its data are on disk before.
const CLOSING: Duration = Duration::from_secs(5);
/// How often a write that goes on is asked whether sled failed meanwhile.
const WATCH: Duration = Duration::from_millis(100);

/// How sled stores tiles: in segments so small that a small map takes little, rewritten when they hold little.
///
/// Without its thread that flushes: all writes here are flushed, and each rewrites a page that wants it. That thread keeps to itself
/// that the disk refused what it rewrote, and the page it began stays in the way of all that is written after it: sled 0.34 returns
/// from `Log::reserve_inner` with the reservation counted and no error noted. A write learns of its own failure.
fn config(dir: &Path, cache_bytes: u64) -> sled::Config {
    const SEGMENT_BYTES: usize = 256 << 10;
    let config = sled::Config::new().path(dir).mode(sled::Mode::LowSpace);
    config.segment_size(SEGMENT_BYTES).cache_capacity(cache_bytes).flush_every_ms(None)
}

impl From<sled::Error> for Error {
    fn from(error: sled::Error) -> Self {
        let io = if let sled::Error::Io(source) = &error { Some(source.kind()) } else { None };
        Self::Tiles { reason: error.to_string(), io }
    }
}

/// A database and the tree in it that holds the tiles.
pub(in crate::store) struct Sled {
    /// `None` once it is dropped.
    handle: Option<(sled::Db, sled::Tree)>,
    /// Shares sled's word on whether it failed.
    config: sled::Config,
    /// sled failed.
    given_up: AtomicBool,
}

impl Sled {
    pub(in crate::store) fn open(dir: &Path, cache_bytes: u64) -> Result<Self, Error> {
        wait_until_unlocked(dir);
        let config = config(dir, cache_bytes);
        let db = config.open()?;
        let tree = db.open_tree("tiles")?;
        Ok(Self { handle: Some((db, tree)), config, given_up: AtomicBool::new(false) })
    }

    /// Writes. Where one of the threads of sled 0.34 fails to write what a reservation left to it, it notes the error and wakes
    /// nobody: who waits for those bytes, as a flush does, waits for ever. Any flush after the error wakes all who wait, and they
    /// see it; so the work is watched, and woken.
    pub(in crate::store) fn watched(
        &self,
        work: impl FnOnce() -> Result<(), sled::Error>,
    ) -> Result<(), Error> {
        let (done, ended) = mpsc::channel::<()>();
        std::thread::scope(|scope| {
            let watch = move || {
                loop {
                    let goes_on = ended.recv_timeout(WATCH) == Err(RecvTimeoutError::Timeout);
                    if self.config.global_error().is_err() {
                        let _ = self.db().flush();
                    }
                    if !goes_on {
                        return;
                    }
                }
            };
            let watcher = std::thread::Builder::new().name("watch-tiles".to_owned());
            watcher
                .spawn_scoped(scope, watch)
                .map_err(|source| Error::Io { doing: "watching the tile store", source })?;
            // Told that the work ended, with a panic as well.
            let _done = done;
            Ok(work()?)
        })
    }

    pub(in crate::store) fn db(&self) -> &sled::Db {
        &self.handle().0
    }

    pub(in crate::store) fn tree(&self) -> &sled::Tree {
        &self.handle().1
    }

    /// Does not close it in the end.
    pub(in crate::store) fn give_up(&self) {
        self.given_up.store(true, Ordering::Release);
    }

    fn handle(&self) -> &(sled::Db, sled::Tree) {
        self.handle.as_ref().expect("it is there until this is dropped")
    }
}

/// After an I/O error sled 0.34 waits for ever when it is dropped: for bytes that nobody writes any more. So an instance
/// that failed is abandoned, with the memory it has, and any other one is closed on a thread that is waited for for a
/// while. What of it was to be kept is on disk: [`crate::store::map::tiles::TileStore::put_all`] flushes.
impl Drop for Sled {
    fn drop(&mut self) {
        let handle = Arc::new(Mutex::new(self.handle.take()));
        let take = |handle: &Mutex<Option<_>>| handle.lock().unwrap_or_else(PoisonError::into_inner).take();
        if self.given_up.load(Ordering::Acquire) {
            std::mem::forget(take(&handle));
            return;
        }
        let (done, closed) = mpsc::sync_channel(1);
        let of_thread = Arc::clone(&handle);
        let close = move || {
            drop(take(&of_thread));
            let _ = done.send(());
        };
        let outcome = match std::thread::Builder::new().name("close-tiles".to_owned()).spawn(close) {
            Ok(_) => closed.recv_timeout(CLOSING).is_ok(),
            Err(_) => false,
        };
        if !outcome {
            std::mem::forget(take(&handle));
            tracing::warn!("the tile store does not close; it is abandoned");
        }
    }
}

/// Waits while an instance of this process that was just dropped still holds the files: sled's threads end a little
/// later, and with them its lock goes. No other process has them, see [`crate::store::local::data_dir`], and who drops an instance
/// to open the next is one thread. So a lock that could be had for a moment here is free for sled. What is held for
/// longer, sled itself refuses.
fn wait_until_unlocked(dir: &Path) {
    // sled 0.34 holds the lock of flock(2), as `File::try_lock` takes it, on this file.
    let Ok(file) = File::open(dir.join("db")) else { return };
    let began = Instant::now();
    while matches!(file.try_lock(), Err(TryLockError::WouldBlock)) && began.elapsed() < LOCK_WAIT {
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Breaks it: not waiting for sled's threads, or for a lock of another file than sled's.
    #[test]
    fn an_instance_that_goes_is_waited_for() {
        let dir = tempfile::tempdir().unwrap();
        let first = Sled::open(dir.path(), 1 << 20).unwrap();
        assert!(config(dir.path(), 1 << 20).open().is_err(), "sled itself does not wait");
        let held = Duration::from_millis(200);
        let began = Instant::now();
        let goes = std::thread::spawn(move || {
            std::thread::sleep(held);
            drop(first);
        });
        assert!(Sled::open(dir.path(), 1 << 20).is_ok());
        assert!(began.elapsed() >= held);
        goes.join().unwrap();
    }
}
