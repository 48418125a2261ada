//! Where the values lie, and how much of each file counts.

use std::collections::BTreeMap;
use std::ops::{Bound, Range};

use super::frame;

/// Size from which a file is followed by the next, bytes: of a small map, and of a large one.
const FILE_BYTES: [u64; 2] = [1 << 20, 32 << 20];

/// Where a value lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    /// Number of the file.
    pub(super) file: u64,
    /// Byte of the file.
    pub(super) offset: u64,
    /// Bytes of the value.
    pub(super) length: u32,
}

impl Place {
    pub(super) fn of(file: u64, value: &Range<usize>) -> Self {
        Self { file, offset: value.start as u64, length: value.len() as u32 }
    }
}

/// Bytes of a file: all, and those of the entries that count.
#[derive(Debug, Clone, Copy, Default)]
struct Share {
    all: u64,
    counts: u64,
}

/// Where the values lie.
#[derive(Debug, Default)]
pub(super) struct Places {
    by_key: BTreeMap<Box<[u8]>, Place>,
    files: BTreeMap<u64, Share>,
    /// The sums over all files.
    sum: Share,
}

impl Places {
    pub(super) fn get(&self, key: &[u8]) -> Option<Place> {
        self.by_key.get(key).copied()
    }

    /// The keys that begin so, in order.
    pub(super) fn keys(&self, prefix: &[u8]) -> Vec<Vec<u8>> {
        let from = (Bound::Included(prefix), Bound::Unbounded);
        let found = self.by_key.range::<[u8], _>(from).map(|(key, _)| key.to_vec());
        found.take_while(|key| key.starts_with(prefix)).collect()
    }

    /// Size from which a file is followed by the next, bytes.
    pub(super) fn file_bytes(&self) -> u64 {
        let [least, most] = FILE_BYTES;
        (self.sum.counts / 16).clamp(least, most)
    }

    /// A file of some bytes begins.
    pub(super) fn begin(&mut self, file: u64, bytes: u64) {
        self.files.insert(file, Share { all: bytes, counts: 0 });
        self.sum.all += bytes;
    }

    /// A file has so many bytes by now.
    pub(super) fn grow(&mut self, file: u64, bytes: u64) {
        let share = self.files.entry(file).or_default();
        self.sum.all += bytes - share.all;
        share.all = bytes;
    }

    /// A value lies there from now on.
    pub(super) fn put(&mut self, key: &[u8], place: Place) {
        let size = frame::size(key, place.length);
        self.files.entry(place.file).or_default().counts += size;
        self.sum.counts += size;
        if let Some(before) = self.by_key.insert(key.into(), place) {
            let size = frame::size(key, before.length);
            self.files.entry(before.file).or_default().counts -= size;
            self.sum.counts -= size;
        }
    }

    /// The file of which least counts, but the newest, when what does not count any more is more than half of what
    /// does.
    pub(super) fn to_be_cleaned(&self, newest: u64) -> Option<u64> {
        let written = self.files.get(&newest).copied().unwrap_or_default();
        let gone = (self.sum.all - written.all).saturating_sub(self.sum.counts - written.counts);
        if gone <= self.sum.counts / 2 {
            return None;
        }
        let least = |share: &Share| (share.counts as f64 / share.all as f64 * 1e6) as u64;
        let old = self.files.iter().filter(|(number, _)| **number != newest);
        old.min_by_key(|(_, share)| least(share)).map(|(number, _)| *number)
    }

    /// A file ends; false when some of it still counts.
    pub(super) fn end(&mut self, file: u64) -> bool {
        match self.files.get(&file) {
            Some(share) if share.counts > 0 => false,
            Some(share) => {
                self.sum.all -= share.all;
                self.files.remove(&file);
                true
            }
            None => true,
        }
    }
}
