//! Values by their keys in append-only files: what is put together is there together or not at all, and what a
//! crash leaves is the state after some earlier put.
//!
//! - [`frame`]: the bytes of a file.
//! - A value that was replaced stays in its file until the file is cleaned: what still counts of it is appended
//!   again, and the file goes. That follows every put, so that the files come to no more than half as much again as
//!   what counts, and one file.
//! - The newest file is synced every half a second of puts, before the next begins, before a cleaned one goes, and by
//!   [`TileLog::flush`]; a power cut takes back the puts since.
//!
//! Nothing is kept open but the file that is written, and nothing in memory but where each value lies.

mod frame;
mod places;

use std::fs::{self, File, OpenOptions};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::{Duration, Instant};

use uuid::Uuid;

pub(super) use frame::Entry;
use frame::HEADER;
use places::{Place, Places};

use super::{Error, io_error};

/// Puts that a power cut may take back were made within this time.
const SYNC_EVERY: Duration = Duration::from_millis(500);
const WRITING: &str = "writing tiles";
const READING: &str = "reading tiles";

/// The values of a directory.
pub(super) struct TileLog {
    dir: PathBuf,
    journal: Uuid,
    places: RwLock<Places>,
    newest: Mutex<Newest>,
}

/// The file that is written.
pub(super) struct Newest {
    number: u64,
    file: File,
    length: u64,
    synced: Instant,
}

impl TileLog {
    /// An empty log in an empty directory.
    ///
    /// # Errors
    /// When the disk refuses.
    pub(super) fn create(dir: &Path, journal: Uuid) -> Result<Self, Error> {
        fs::create_dir_all(dir).map_err(io_error(WRITING))?;
        let mut places = Places::default();
        let newest = begin(dir, journal, 1, &mut places)?;
        Ok(Self { dir: dir.to_owned(), journal, places: RwLock::new(places), newest: Mutex::new(newest) })
    }

    /// The log of a directory, up to the last put that is whole.
    ///
    /// # Errors
    /// When the disk refuses, there is no log of this journal, or it is damaged otherwise than by a torn write.
    pub(super) fn open(dir: &Path, journal: Uuid) -> Result<Self, Error> {
        let numbers = numbers(dir)?;
        let (mut places, mut end) = (Places::default(), None);
        for (at, number) in numbers.iter().enumerate() {
            let (path, newest) = (path(dir, *number), at + 1 == numbers.len());
            let file = fs::read(&path).map_err(io_error(READING))?;
            if !file.starts_with(&frame::header(journal, *number)) {
                // The crash came while it was begun. The one before was synced by then.
                if newest && at > 0 && file.len() <= HEADER {
                    fs::remove_file(&path).map_err(io_error("removing unfinished tiles"))?;
                    break;
                }
                return Err(damaged(&path, "it is no file of this journal's tiles"));
            }
            let (found, sound) = frame::walk(*number, &file);
            if sound < file.len() && !newest {
                return Err(damaged(&path, "a frame does not match its checksum"));
            }
            places.begin(*number, HEADER as u64);
            for entry in found {
                places.put(entry.key, Place::of(*number, &entry.value));
            }
            places.grow(*number, sound as u64);
            end = Some((*number, sound as u64));
        }
        let (number, length) = end.ok_or_else(|| damaged(dir, "there are no tiles in it"))?;
        let file = OpenOptions::new().write(true).open(path(dir, number)).map_err(io_error(WRITING))?;
        file.set_len(length).map_err(io_error(WRITING))?;
        let newest = Mutex::new(Newest { number, file, length, synced: Instant::now() });
        Ok(Self { dir: dir.to_owned(), journal, places: RwLock::new(places), newest })
    }

    /// A value; `None` where nothing was put. Its content is for the caller to check.
    ///
    /// # Errors
    /// When the disk refuses.
    pub(super) fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, Error> {
        let places = self.places();
        let Some(Place { file, offset, length }) = places.get(key) else { return Ok(None) };
        let opened = File::open(path(&self.dir, file)).map_err(io_error(READING))?;
        // An open file stays readable when it is cleaned.
        drop(places);
        let mut value = vec![0; length as usize];
        opened.read_exact_at(&mut value, offset).map_err(io_error(READING))?;
        Ok(Some(value))
    }

    /// The keys that begin so, in order.
    pub(super) fn keys(&self, prefix: &[u8]) -> Vec<Vec<u8>> {
        self.places().keys(prefix)
    }

    /// Puts values in place of what was there, all or none; of two under one key the later one counts.
    ///
    /// # Errors
    /// When the disk refuses: the values may be there or not.
    pub(super) fn put(&self, entries: &[Entry]) -> Result<(), Error> {
        let mut newest = self.paused();
        self.append(&mut newest, entries)?;
        if newest.synced.elapsed() > SYNC_EVERY {
            newest.sync()?;
        }
        self.clean(&mut newest)
    }

    /// Brings everything to disk.
    ///
    /// # Errors
    /// When the disk refuses.
    pub(super) fn flush(&self) -> Result<(), Error> {
        self.paused().sync()
    }

    /// Nothing is put while this is held.
    pub(super) fn paused(&self) -> MutexGuard<'_, Newest> {
        // What a panic left half written is written over.
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn append(&self, newest: &mut Newest, entries: &[Entry]) -> Result<(), Error> {
        if newest.length >= self.places().file_bytes() {
            newest.sync()?;
            *newest = begin(&self.dir, self.journal, newest.number + 1, &mut self.places_mut())?;
        }
        let too_large = || Error::Unusable("more than 4 GiB of tiles change at once".to_owned());
        let (bytes, values) = frame::encode(newest.number, newest.length, entries).ok_or_else(too_large)?;
        newest.file.write_all_at(&bytes, newest.length).map_err(io_error(WRITING))?;
        newest.length += bytes.len() as u64;
        let mut places = self.places_mut();
        places.grow(newest.number, newest.length);
        for ((key, value), offset) in entries.iter().zip(values) {
            let length = value.len() as u32;
            places.put(key, Place { file: newest.number, offset, length });
        }
        Ok(())
    }

    /// Removes files of which little counts any more, until what all take is in proportion.
    fn clean(&self, newest: &mut Newest) -> Result<(), Error> {
        loop {
            let Some(worst) = self.places().to_be_cleaned(newest.number) else { return Ok(()) };
            let path = path(&self.dir, worst);
            let file = fs::read(&path).map_err(io_error(READING))?;
            let kept: Vec<Entry> = {
                let places = self.places();
                let (found, _) = frame::walk(worst, &file);
                let counts =
                    |entry: &frame::Found<'_>| places.get(entry.key) == Some(Place::of(worst, &entry.value));
                let kept = found.into_iter().filter(counts);
                kept.map(|entry| (entry.key.to_vec(), file[entry.value].to_vec())).collect()
            };
            if !kept.is_empty() {
                self.append(newest, &kept)?;
                newest.sync()?;
            }
            // What is damaged in the file cannot be moved: then it stays.
            if self.places_mut().end(worst) {
                fs::remove_file(&path).map_err(io_error("removing old tiles"))?;
            } else {
                return Err(damaged(&path, "a frame does not match its checksum"));
            }
        }
    }

    fn places(&self) -> RwLockReadGuard<'_, Places> {
        // A panic between two of its changes leaves less to be read, which the digest of the tiles tells.
        self.places.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn places_mut(&self) -> RwLockWriteGuard<'_, Places> {
        self.places.write().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Newest {
    fn sync(&mut self) -> Result<(), Error> {
        self.synced = Instant::now();
        self.file.sync_data().map_err(io_error("syncing tiles"))
    }
}

/// Begins a file; its name is on disk when this returns.
fn begin(dir: &Path, journal: Uuid, number: u64, places: &mut Places) -> Result<Newest, Error> {
    let file = File::create(path(dir, number)).map_err(io_error(WRITING))?;
    file.write_all_at(&frame::header(journal, number), 0).map_err(io_error(WRITING))?;
    file.sync_data().and_then(|()| File::open(dir)?.sync_all()).map_err(io_error("syncing tiles"))?;
    places.begin(number, HEADER as u64);
    Ok(Newest { number, file, length: HEADER as u64, synced: Instant::now() })
}

fn path(dir: &Path, number: u64) -> PathBuf {
    dir.join(format!("{number:012}.tiles"))
}

/// The numbers of the files, in order. Whatever else is there makes the log unusable.
fn numbers(dir: &Path) -> Result<Vec<u64>, Error> {
    let mut numbers = Vec::new();
    for entry in fs::read_dir(dir).map_err(io_error(READING))? {
        let found = entry.map_err(io_error(READING))?.path();
        let name = found.file_name().and_then(|name| name.to_str()?.strip_suffix(".tiles")?.parse().ok());
        let number = name.filter(|number| path(dir, *number) == found);
        numbers.push(number.ok_or_else(|| damaged(&found, "it does not belong there"))?);
    }
    numbers.sort_unstable();
    Ok(numbers)
}

fn damaged(path: &Path, reason: &str) -> Error {
    Error::Damaged { what: path.display().to_string(), reason: reason.to_owned() }
}

#[cfg(test)]
mod tests;
