//! A backend in memory, for tests. It can lose what was not made durable, as a power cut does.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::{Arc, Mutex, MutexGuard};

use siphasher::sip::SipHasher24;

use super::Backend;
use super::manifests::Manifests;
use super::objects::{Objects, Readable};
use super::owner::{Fence, KEY, Pseudonyms};
use super::segments::{HEADER, Listed, Medium, Segments};
use crate::store::api::Error;

mod table;

use table::{MemoryTables, Tables};

/// What a disk would hold.
#[derive(Clone, Default)]
pub(in crate::store) struct Memory(Arc<Disk>);

#[derive(Default)]
struct Disk {
    objects: Mutex<BTreeMap<String, Arc<[u8]>>>,
    segments: Mutex<BTreeMap<u64, Segment>>,
    /// A chain, of which the last counts.
    manifests: Mutex<Vec<Vec<u8>>>,
    tables: Arc<Tables>,
    /// Number of the last opening.
    writer: Mutex<u64>,
}

type Segment = Arc<Mutex<Contents>>;

#[derive(Default)]
struct Contents {
    bytes: Vec<u8>,
    /// How many of them are durable.
    durable: usize,
}

impl Memory {
    /// Opens it, and takes it over from whoever had it.
    pub(in crate::store) fn open(&self) -> Backend {
        let mut writer = locked(&self.0.writer);
        *writer += 1;
        locked(&self.0.objects).entry(KEY.to_owned()).or_insert_with(|| [7; 16].into());
        let home = Arc::new(Home { disk: self.0.clone(), writer: *writer });
        Backend {
            objects: home.clone(),
            segments: home.clone(),
            manifests: home.clone(),
            tables: Arc::new(MemoryTables(self.0.tables.clone())),
            fence: home.clone(),
            pseudonyms: home,
        }
    }

    /// A power cut: of what was not durable every segment keeps as many bytes as `kept` says of it.
    pub(in crate::store) fn cut_power(&self, kept: impl Fn(usize) -> usize) {
        for segment in locked(&self.0.segments).values_mut() {
            let mut contents = std::mem::take(&mut *locked(segment));
            let left = contents.durable + kept(contents.bytes.len() - contents.durable);
            contents.bytes.truncate(left);
            // What the former process still writes goes nowhere.
            *segment = Arc::new(Mutex::new(Contents { durable: contents.bytes.len(), ..contents }));
        }
        self.0.tables.cut_power();
    }
}

/// A disk, as one who opened it sees it.
struct Home {
    disk: Arc<Disk>,
    writer: u64,
}

impl Home {
    fn segment(&self, first: u64) -> io::Result<Segment> {
        locked(&self.disk.segments).get(&first).cloned().ok_or_else(|| io::ErrorKind::NotFound.into())
    }
}

impl Objects for Home {
    fn put_new(&self, name: &str, write: &mut dyn FnMut(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        let mut bytes = Vec::new();
        write(&mut bytes)?;
        let mut objects = locked(&self.disk.objects);
        if objects.contains_key(name) {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        objects.insert(name.to_owned(), bytes.into());
        Ok(())
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn Readable>> {
        let object = locked(&self.disk.objects).get(name).cloned();
        Ok(Box::new(object.ok_or(io::ErrorKind::NotFound)?))
    }

    fn list(&self, prefix: &str) -> io::Result<Vec<String>> {
        let objects = locked(&self.disk.objects);
        Ok(objects.keys().filter(|name| name.starts_with(prefix)).cloned().collect())
    }

    fn delete(&self, name: &str) -> io::Result<()> {
        locked(&self.disk.objects).remove(name);
        Ok(())
    }

    fn locate(&self, name: &str) -> String {
        name.to_owned()
    }
}

impl Segments for Home {
    fn list(&self) -> io::Result<Vec<Listed>> {
        let segments = locked(&self.disk.segments);
        let listed = |(first, segment): (&u64, &Segment)| Listed {
            first: *first,
            bytes: locked(segment).bytes.len() as u64,
        };
        Ok(segments.iter().map(listed).collect())
    }

    fn open(&self, first: u64) -> io::Result<Box<dyn Readable>> {
        Ok(Box::new(self.segment(first)?))
    }

    fn create(&self, first: u64, header: &[u8; HEADER]) -> io::Result<Box<dyn Medium>> {
        if locked(&self.disk.segments).contains_key(&first) {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        self.replace(first, header)
    }

    fn replace(&self, first: u64, header: &[u8; HEADER]) -> io::Result<Box<dyn Medium>> {
        let contents = Contents { bytes: header.to_vec(), durable: HEADER };
        let segment = Arc::new(Mutex::new(contents));
        locked(&self.disk.segments).insert(first, segment.clone());
        Ok(Box::new(segment))
    }

    fn resume(&self, first: u64) -> io::Result<Box<dyn Medium>> {
        Ok(Box::new(self.segment(first)?))
    }

    fn delete(&self, firsts: &[u64]) -> io::Result<()> {
        locked(&self.disk.segments).retain(|first, _| !firsts.contains(first));
        Ok(())
    }

    fn locate(&self, first: u64) -> String {
        super::segments::name(first)
    }
}

impl Medium for Segment {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        locked(self).bytes.extend_from_slice(bytes);
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        let mut contents = locked(self);
        contents.durable = contents.bytes.len();
        Ok(())
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        locked(self).bytes.truncate(length as usize);
        self.sync()
    }
}

impl Readable for Segment {
    fn length(&self) -> io::Result<u64> {
        Ok(locked(self).bytes.len() as u64)
    }

    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        part(&locked(self).bytes, at, out)
    }
}

impl Readable for Arc<[u8]> {
    fn length(&self) -> io::Result<u64> {
        Ok(self.len() as u64)
    }

    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        part(self, at, out)
    }
}

fn part(bytes: &[u8], at: u64, out: &mut [u8]) -> io::Result<()> {
    let asked = bytes.get(at as usize..).and_then(|rest| rest.get(..out.len()));
    out.copy_from_slice(asked.ok_or(io::ErrorKind::UnexpectedEof)?);
    Ok(())
}

impl Manifests for Home {
    fn newest(&self) -> Result<Option<Vec<u8>>, Error> {
        Ok(locked(&self.disk.manifests).last().cloned())
    }

    fn publish(&self, manifest: &[u8]) -> Result<(), Error> {
        self.check()?;
        locked(&self.disk.manifests).push(manifest.to_vec());
        Ok(())
    }

    fn set_aside(&self, _: &str) -> Result<(), Error> {
        locked(&self.disk.manifests).clear();
        Ok(())
    }
}

impl Fence for Home {
    fn check(&self) -> Result<(), Error> {
        let ours = *locked(&self.disk.writer) == self.writer;
        ours.then_some(()).ok_or_else(|| Error::Stopped("another server has this memory".to_owned()))
    }
}

impl Pseudonyms for Home {
    fn hash(&self, pseudonym: &str) -> u64 {
        SipHasher24::new_with_key(&[7; 16]).hash(pseudonym.as_bytes())
    }

    fn damage(&self) -> Vec<String> {
        Vec::new()
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("nothing panics while it holds one of these")
}
