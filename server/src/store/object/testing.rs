//! Buckets for tests: in memory, and around it one that lets requests fail.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use object_store::memory::InMemory;
use siphasher::sip::SipHasher24;

use super::bucket::{Bucket, Created, Failure, Listed};
use super::client::{Client, Patience};
use super::remote::Remote;

/// A bucket in memory, which keeps all promises.
pub(in crate::store) fn memory() -> Arc<dyn Bucket> {
    Arc::new(Remote::over(Arc::new(InMemory::new()), "fleet/a", "memory:").unwrap())
}

/// A client that does not wait for long.
pub(in crate::store) fn client(bucket: Arc<dyn Bucket>) -> Client {
    let ms = Duration::from_millis;
    Client::new(bucket, Patience { pause: ms(1), longest: ms(2), limit: ms(40) })
}

/// A bucket that puts objects whose names contain a word over those that are there, as if nothing had been asked of it.
pub(in crate::store) struct Ignoring {
    pub(in crate::store) inner: Arc<dyn Bucket>,
    pub(in crate::store) word: &'static str,
}

impl Bucket for Ignoring {
    fn create(&self, name: &str, body: &[u8]) -> Result<Created, Failure> {
        if name.contains(self.word) {
            self.inner.delete(name)?;
        }
        self.inner.create(name, body)
    }

    fn get(&self, name: &str, range: Option<Range<u64>>) -> Result<Option<Vec<u8>>, Failure> {
        self.inner.get(name, range)
    }

    fn list(&self, folder: &str) -> Result<Vec<Listed>, Failure> {
        self.inner.list(folder)
    }

    fn delete(&self, name: &str) -> Result<(), Failure> {
        self.inner.delete(name)
    }

    fn locate(&self, name: &str) -> String {
        self.inner.locate(name)
    }
}

/// A bucket that can be switched off.
pub(in crate::store) struct Switched {
    pub(in crate::store) inner: Arc<dyn Bucket>,
    pub(in crate::store) off: Arc<AtomicBool>,
}

impl Switched {
    fn on<T>(&self, request: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
        let off = self.off.load(Ordering::Relaxed);
        if off { Err(Failure::Unknown("nobody answers".to_owned())) } else { request() }
    }
}

impl Bucket for Switched {
    fn create(&self, name: &str, body: &[u8]) -> Result<Created, Failure> {
        self.on(|| self.inner.create(name, body))
    }

    fn get(&self, name: &str, range: Option<Range<u64>>) -> Result<Option<Vec<u8>>, Failure> {
        self.on(|| self.inner.get(name, range))
    }

    fn list(&self, folder: &str) -> Result<Vec<Listed>, Failure> {
        self.on(|| self.inner.list(folder))
    }

    fn delete(&self, name: &str) -> Result<(), Failure> {
        self.on(|| self.inner.delete(name))
    }

    fn locate(&self, name: &str) -> String {
        self.inner.locate(name)
    }
}

/// A bucket of whose requests some fail: drawn from a seed and how many were made.
pub(in crate::store) struct Failing {
    inner: Arc<dyn Bucket>,
    seed: u64,
    per_mille: u64,
    made: AtomicU64,
    lists: Mutex<HashMap<String, Vec<Listed>>>,
}

impl Failing {
    pub(in crate::store) fn around(inner: Arc<dyn Bucket>, seed: u64, per_mille: u64) -> Self {
        Self { inner, seed, per_mille, made: AtomicU64::default(), lists: Mutex::default() }
    }

    /// What the next request does: `None` when it is well.
    fn draw(&self) -> Option<u64> {
        let made = self.made.fetch_add(1, Ordering::Relaxed);
        let word = SipHasher24::new_with_keys(self.seed, 7).hash(&made.to_le_bytes());
        (word % 1000 < self.per_mille).then_some(word / 1000)
    }

    fn with<T>(&self, request: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
        let lost = |what: &str| Failure::Unknown(format!("the test lets {what}"));
        match self.draw().map(|word| (word % 4, word / 4)) {
            None => request(),
            Some((0, _)) => Err(lost("this fail")),
            Some((1, _)) => request().and(Err(lost("the answer be lost"))),
            Some((_, word)) => {
                // Long enough for others to fold and collect meanwhile, now and then.
                std::thread::sleep(Duration::from_micros(if word % 8 == 0 { 20_000 } else { word % 500 }));
                request()
            }
        }
    }
}

impl Bucket for Failing {
    fn create(&self, name: &str, body: &[u8]) -> Result<Created, Failure> {
        self.with(|| self.inner.create(name, body))
    }

    fn get(&self, name: &str, range: Option<Range<u64>>) -> Result<Option<Vec<u8>>, Failure> {
        self.with(|| self.inner.get(name, range))
    }

    fn list(&self, folder: &str) -> Result<Vec<Listed>, Failure> {
        let stale = self.draw().is_some_and(|word| word % 2 == 0);
        let mut lists = self.lists.lock().unwrap();
        if let Some(old) = lists.get(folder).filter(|_| stale) {
            return Ok(old.clone());
        }
        let listed = self.with(|| self.inner.list(folder))?;
        lists.insert(folder.to_owned(), listed.clone());
        Ok(listed)
    }

    fn delete(&self, name: &str) -> Result<(), Failure> {
        self.with(|| self.inner.delete(name))
    }

    fn locate(&self, name: &str) -> String {
        self.inner.locate(name)
    }
}
