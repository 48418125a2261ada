//! One instance of sled, opened and closed so that neither can stop the service.

use std::fs::{File, TryLockError};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use crate::store::api::Error;

/// How long a dropped instance may take to let go.
const LOCK_WAIT: Duration = Duration::from_secs(10);
/// How long an instance may take to close. All of its data are on disk before.
const CLOSING: Duration = Duration::from_secs(5);

/// How sled stores tiles: in segments so small that a small map takes little, rewritten when they hold little.
fn config(dir: &Path, cache_bytes: u64) -> sled::Config {
    const SEGMENT_BYTES: usize = 256 << 10;
    let config = sled::Config::new().path(dir).mode(sled::Mode::LowSpace);
    config.segment_size(SEGMENT_BYTES).cache_capacity(cache_bytes)
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
    /// sled failed.
    given_up: AtomicBool,
}

impl Sled {
    pub(in crate::store) fn open(dir: &Path, cache_bytes: u64) -> Result<Self, Error> {
        wait_until_unlocked(dir);
        let db = config(dir, cache_bytes).open()?;
        let tree = db.open_tree("tiles")?;
        Ok(Self { handle: Some((db, tree)), given_up: AtomicBool::new(false) })
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
