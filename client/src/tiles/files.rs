//! The files of a cache.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use echofix_core::geo::{TileId, Zone};

use super::index::CacheIndex;
use super::name::TileVersionName;
use super::{Error, io_error};
use crate::disk;

/// The tiles of a folder, in the order in which they were used last; removes what a crash left.
pub(super) fn scan(dir: &Path) -> Result<CacheIndex, Error> {
    let mut found: Vec<(SystemTime, TileVersionName, u64)> = Vec::new();
    for folder in entries(dir)? {
        let epsg = folder.file_name().and_then(|name| name.to_str()?.parse().ok());
        let Some(zone) = epsg.and_then(|epsg| Zone::from_epsg(epsg).ok()) else { continue };
        for path in entries(&folder)? {
            if path.extension().is_some_and(|ending| ending == disk::PART) {
                remove(&path)?;
            } else if let Some(name) = TileVersionName::of(zone, &path) {
                let data = fs::metadata(&path).map_err(io_error(&path))?;
                found.push((data.modified().map_err(io_error(&path))?, name, data.len()));
            }
        }
    }
    found.sort_unstable();
    let mut index = CacheIndex::default();
    for (_, name, bytes) in found {
        // A crash came before the older version was removed. Should the newer be the one that goes, it is fetched again.
        if let Some(older) = index.name(name.id) {
            remove(&older.path(dir))?;
        }
        index.insert(name, bytes);
    }
    Ok(index)
}

/// Refuses a folder that holds other things than tiles, and no tiles: it was named by mistake.
pub(super) fn refuse_foreign(dir: &Path) -> Result<(), Error> {
    let names: Vec<String> = entries(dir)?
        .iter()
        .filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned()))
        .collect();
    let is_zone = |name: &String| name.parse().is_ok_and(|epsg| Zone::from_epsg(epsg).is_ok());
    if names.iter().any(is_zone) {
        return Ok(());
    }
    match names.into_iter().find(|name| !["lock", "lost+found"].contains(&&**name)) {
        Some(entry) => Err(Error::Foreign { dir: dir.to_owned(), entry }),
        None => Ok(()),
    }
}

fn entries(dir: &Path) -> Result<Vec<PathBuf>, Error> {
    let entries = fs::read_dir(dir).map_err(io_error(dir))?;
    entries.map(|entry| entry.map(|entry| entry.path()).map_err(io_error(dir))).collect()
}

/// The folder of a tile's zone, which is made when it is the zone's first.
pub(super) fn zone_folder(dir: &Path, id: TileId) -> Result<PathBuf, Error> {
    let zone = dir.join(id.zone.epsg().to_string());
    if !zone.is_dir() {
        fs::create_dir(&zone).map_err(io_error(&zone))?;
        File::open(dir).and_then(|dir| dir.sync_all()).map_err(io_error(dir))?;
    }
    Ok(zone)
}

/// Reads a file and notes the use in its time of modification, by which the next run knows it.
pub(super) fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = File::open(path)?;
    let mut contents = Vec::new();
    file.read_to_end(&mut contents)?;
    note_use(&file);
    Ok(contents)
}

/// Writes a file that appears whole or not at all; writing it is a use.
pub(super) fn write(zone: &Path, path: &Path, contents: &[u8]) -> io::Result<()> {
    disk::write_durably(zone, path, contents)?;
    // The file system's own times are as coarse as its ticks.
    File::open(path).map(|file| note_use(&file))
}

fn note_use(file: &File) {
    // Without it the tile only goes earlier.
    let _ = file.set_modified(SystemTime::now());
}

/// Removes a file, if it is there.
pub(super) fn remove(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(io_error(path)(e)),
        _ => Ok(()),
    }
}
