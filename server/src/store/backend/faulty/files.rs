//! Faults around objects, segments, manifests and the fence.

use std::collections::HashMap;
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use super::{Call, Fault, Faults, with};
use crate::store::api::Error;
use crate::store::backend::manifests::Manifests;
use crate::store::backend::objects::{Objects, Readable};
use crate::store::backend::owner::Fence;
use crate::store::backend::segments::{HEADER, Listed, Medium, Segments};

pub(super) struct FaultyObjects {
    inner: Arc<dyn Objects>,
    faults: Faults,
    /// The last list of each prefix.
    listed: Mutex<HashMap<String, Vec<String>>>,
}

impl FaultyObjects {
    pub(super) fn new(inner: Arc<dyn Objects>, faults: Faults) -> Self {
        Self { inner, faults, listed: Mutex::default() }
    }
}

impl Objects for FaultyObjects {
    fn put_new(&self, name: &str, write: &mut dyn FnMut(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        self.faults.call(Call::PutObject, || self.inner.put_new(name, write))
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn Readable>> {
        let opened = self.faults.call(Call::OpenObject, || self.inner.open(name))?;
        Ok(Box::new(FaultyReadable { inner: opened, faults: self.faults.clone() }))
    }

    fn list(&self, prefix: &str) -> io::Result<Vec<String>> {
        let fault = self.faults.next(Call::ListObjects);
        let mut listed = self.listed.lock().unwrap_or_else(PoisonError::into_inner);
        if let (Some(Fault::Stale), Some(old)) = (fault, listed.get(prefix)) {
            return Ok(old.clone());
        }
        let names = with(fault, || self.inner.list(prefix))?;
        listed.insert(prefix.to_owned(), names.clone());
        Ok(names)
    }

    fn delete(&self, name: &str) -> io::Result<()> {
        self.faults.call(Call::DeleteObject, || self.inner.delete(name))
    }

    fn locate(&self, name: &str) -> String {
        self.inner.locate(name)
    }
}

struct FaultyReadable {
    inner: Box<dyn Readable>,
    faults: Faults,
}

impl Readable for FaultyReadable {
    fn length(&self) -> io::Result<u64> {
        self.inner.length()
    }

    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        self.faults.call(Call::Read, || self.inner.read_at(at, out))
    }
}

pub(super) struct FaultySegments {
    inner: Arc<dyn Segments>,
    faults: Faults,
}

impl FaultySegments {
    pub(super) fn new(inner: Arc<dyn Segments>, faults: Faults) -> Self {
        Self { inner, faults }
    }

    fn begun(&self, begin: impl FnOnce() -> io::Result<Box<dyn Medium>>) -> io::Result<Box<dyn Medium>> {
        let inner = self.faults.call(Call::BeginSegment, begin)?;
        Ok(Box::new(FaultyMedium { inner, faults: self.faults.clone() }))
    }
}

impl Segments for FaultySegments {
    fn list(&self) -> io::Result<Vec<Listed>> {
        self.faults.call(Call::ListSegments, || self.inner.list())
    }

    fn open(&self, first: u64) -> io::Result<Box<dyn Readable>> {
        let opened = self.faults.call(Call::OpenSegment, || self.inner.open(first))?;
        Ok(Box::new(FaultyReadable { inner: opened, faults: self.faults.clone() }))
    }

    fn create(&self, first: u64, header: &[u8; HEADER]) -> io::Result<Box<dyn Medium>> {
        self.begun(|| self.inner.create(first, header))
    }

    fn replace(&self, first: u64, header: &[u8; HEADER]) -> io::Result<Box<dyn Medium>> {
        self.begun(|| self.inner.replace(first, header))
    }

    fn resume(&self, first: u64) -> io::Result<Box<dyn Medium>> {
        self.begun(|| self.inner.resume(first))
    }

    fn delete(&self, firsts: &[u64]) -> io::Result<()> {
        self.faults.call(Call::DeleteSegments, || self.inner.delete(firsts))
    }

    fn locate(&self, first: u64) -> String {
        self.inner.locate(first)
    }
}

struct FaultyMedium {
    inner: Box<dyn Medium>,
    faults: Faults,
}

impl Medium for FaultyMedium {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let fault = self.faults.next(Call::Append);
        if fault == Some(Fault::Torn) {
            self.inner.append(&bytes[..bytes.len() / 2])?;
        }
        with(fault, || self.inner.append(bytes))
    }

    fn sync(&mut self) -> io::Result<()> {
        self.faults.call(Call::Sync, || self.inner.sync())
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.faults.call(Call::Cut, || self.inner.cut(length))
    }
}

pub(super) struct FaultyOwner {
    manifests: Arc<dyn Manifests>,
    fence: Arc<dyn Fence>,
    faults: Faults,
}

impl FaultyOwner {
    pub(super) fn new(manifests: Arc<dyn Manifests>, fence: Arc<dyn Fence>, faults: Faults) -> Self {
        Self { manifests, fence, faults }
    }
}

impl Manifests for FaultyOwner {
    fn newest(&self) -> Result<Option<Vec<u8>>, Error> {
        self.faults.call(Call::Newest, || self.manifests.newest())
    }

    fn publish(&self, manifest: &[u8]) -> Result<(), Error> {
        self.faults.call(Call::Publish, || self.manifests.publish(manifest))
    }

    fn set_aside(&self, why: &str) -> Result<(), Error> {
        self.faults.call(Call::SetAside, || self.manifests.set_aside(why))
    }
}

impl Fence for FaultyOwner {
    fn check(&self) -> Result<(), Error> {
        self.faults.call(Call::CheckFence, || self.fence.check())
    }
}
