//! Requests that are tried again, and whose outcome is read back.

use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::bucket::{Bucket, Created, Failure, Listed};
use crate::store::api::{Error, io_error};

/// How long a request that has no answer is tried again.
#[derive(Debug, Clone, Copy)]
pub(in crate::store) struct Patience {
    /// The first pause; each further one is twice as long at most.
    pub(in crate::store) pause: Duration,
    /// The longest pause.
    pub(in crate::store) longest: Duration,
    /// After this nothing is tried again.
    pub(in crate::store) limit: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        let ms = Duration::from_millis;
        Self { pause: ms(20), longest: ms(1000), limit: ms(8000) }
    }
}

/// What became of an object that was to be put under a name.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::store) enum Put {
    /// It has the name.
    Ours,
    /// Another one has it: its bytes.
    Theirs(Vec<u8>),
}

/// A bucket that is asked again. Every call may wait for as long as its patience: keep it off the async threads.
#[derive(Clone)]
pub(in crate::store) struct Client {
    bucket: Arc<dyn Bucket>,
    patience: Patience,
}

impl Client {
    pub(in crate::store) fn new(bucket: Arc<dyn Bucket>, patience: Patience) -> Self {
        Self { bucket, patience }
    }

    /// Single requests.
    pub(in crate::store) fn bucket(&self) -> &dyn Bucket {
        &*self.bucket
    }

    /// Puts an object if there is none of its name. No two callers may put the same bytes: they are what an object is known
    /// by. That a name is taken means: go and look whose it is.
    ///
    /// # Errors
    /// When the outcome is not known; the object may be there, now or later.
    pub(in crate::store) fn put_new(&self, name: &str, body: &[u8]) -> Result<Put, Error> {
        let mut tries = Tries::new(self.patience);
        loop {
            let taken = match self.bucket.create(name, body) {
                Ok(Created::Won) => return Ok(Put::Ours),
                Ok(Created::Taken) => true,
                Err(failure) => {
                    tries.again(&failure)?;
                    false
                }
            };
            match self.get(name)? {
                Some(found) if found == body => return Ok(Put::Ours),
                Some(found) => return Ok(Put::Theirs(found)),
                // Somebody else is at it, or it was collected: then the name is free.
                None if taken => {
                    tries.again(&Failure::Unknown("the name is taken, and nothing is there".to_owned()))?;
                }
                None => {}
            }
        }
    }

    /// An object; `None` where there is none.
    ///
    /// # Errors
    /// When there is no answer.
    pub(in crate::store) fn get(&self, name: &str) -> Result<Option<Vec<u8>>, Error> {
        self.tried(|| self.bucket.get(name, None))
    }

    /// Some bytes of an object, fewer where it ends before.
    ///
    /// # Errors
    /// When there is no answer.
    pub(in crate::store) fn get_range(
        &self,
        name: &str,
        range: Range<u64>,
    ) -> Result<Option<Vec<u8>>, Error> {
        self.tried(|| self.bucket.get(name, Some(range.clone())))
    }

    /// The objects of a folder. A list may be old.
    ///
    /// # Errors
    /// When there is no answer.
    pub(in crate::store) fn list(&self, folder: &str) -> Result<Vec<Listed>, Error> {
        self.tried(|| self.bucket.list(folder))
    }

    /// Deletes an object; one that is not there is no error.
    ///
    /// # Errors
    /// When there is no answer.
    pub(in crate::store) fn delete(&self, name: &str) -> Result<(), Error> {
        self.tried(|| self.bucket.delete(name))
    }

    /// Where an object is, for whoever runs the store.
    pub(in crate::store) fn locate(&self, name: &str) -> String {
        self.bucket.locate(name)
    }

    /// Does the store take and give anything? Asked once, without patience.
    ///
    /// # Errors
    /// When it does not.
    pub(in crate::store) fn tries_once(&self, name: &str) -> Result<(), Error> {
        let asked = self.bucket.create(name, b"trial").and_then(|_| self.bucket.delete(name));
        asked.map_err(|failure| failed(&failure))
    }

    fn tried<T>(&self, request: impl Fn() -> Result<T, Failure>) -> Result<T, Error> {
        let mut tries = Tries::new(self.patience);
        loop {
            match request() {
                Ok(answer) => return Ok(answer),
                Err(failure) => tries.again(&failure)?,
            }
        }
    }
}

struct Tries {
    patience: Patience,
    began: Instant,
    pause: Duration,
}

impl Tries {
    fn new(patience: Patience) -> Self {
        Self { patience, began: Instant::now(), pause: patience.pause }
    }

    /// Waits before the next try: a random part of the pause, so that servers that failed together do not come back
    /// together.
    fn again(&mut self, failure: &Failure) -> Result<(), Error> {
        let vain = matches!(failure, Failure::Refused(_));
        if vain || self.began.elapsed() + self.pause > self.patience.limit {
            return Err(failed(failure));
        }
        // Without randomness all wait the whole pause.
        let part = getrandom::u32().map_or(1.0, |word| f64::from(word) / f64::from(u32::MAX));
        std::thread::sleep(self.pause.mul_f64(part));
        self.pause = (self.pause * 2).min(self.patience.longest);
        Ok(())
    }
}

fn failed(failure: &Failure) -> Error {
    let kind = match failure {
        Failure::Unknown(_) => std::io::ErrorKind::TimedOut,
        Failure::Refused(_) => std::io::ErrorKind::PermissionDenied,
    };
    io_error("asking the object store")(std::io::Error::new(kind, failure.to_string()))
}
