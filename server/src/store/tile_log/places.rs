//! Where the values lie, and how much of each file counts.

use std::collections::BTreeMap;
use std::ops::Range;

use super::frame;

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

    pub(super) fn keys(&self) -> Vec<Vec<u8>> {
        self.by_key.keys().map(|key| key.to_vec()).collect()
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

    /// The file of which least counts, but the newest, when all together take more than half as much again as what
    /// counts, and a file.
    pub(super) fn to_be_cleaned(&self, newest: u64, file_bytes: u64) -> Option<u64> {
        if self.sum.all <= self.sum.counts + self.sum.counts / 2 + file_bytes {
            return None;
        }
        let old = self.files.iter().filter(|(number, share)| **number != newest && share.all > share.counts);
        let least = |share: &Share| (share.counts as f64 / share.all as f64 * 1e6) as u64;
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
