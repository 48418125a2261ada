//! Journal to tiles: one way for uploads that just came, for those a crash left over, and for a map
//! that is rebuilt from nothing.
//!
//! Folding is idempotent tile by tile: a tile knows the last upload it holds and skips those up to
//! it. So it does not matter which of its writes sled lost, only from where folding resumes.

use std::collections::{BTreeMap, HashMap};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

use echofix_core::geo::TileId;
use uuid::Uuid;

use super::journal::Written;
use super::shared::Shared;
use super::tiles::Tiles;
use super::{Error, State, TileInfo, Upload, io_error, record};

/// How long folding rests after an error.
const RETRY: Duration = Duration::from_secs(5);

/// Tiles that are sound, and the upload after which folding must resume.
pub(super) struct Resumed {
    pub(super) tiles: Tiles,
    pub(super) sound: Vec<TileInfo>,
    pub(super) folded: u64,
}

/// Opens the tiles and compares them with the journal: `newest` is the last upload that touches
/// each tile, `end` the journal's last. A store that cannot be opened is put aside.
pub(super) fn resume(
    dir: &Path,
    cache_bytes: u64,
    journal: Uuid,
    newest: &HashMap<TileId, u64>,
    end: u64,
) -> Result<Resumed, Error> {
    let (tiles, found) = match open(dir, cache_bytes, journal) {
        Ok(opened) => opened,
        Err(reason) => {
            tracing::warn!(reason, "the tiles cannot be used; rebuilding them from the journal");
            put_aside(dir)?;
            open(dir, cache_bytes, journal).map_err(|reason| Error::Damaged {
                what: format!("the new tile store {}", dir.display()),
                reason,
            })?
        }
    };
    let mut versions = HashMap::new();
    let mut sound = Vec::with_capacity(found.len());
    for info in found {
        match newest.get(&info.id) {
            Some(newest) if info.version <= *newest => {
                versions.insert(info.id, info.version);
                sound.push(info);
            }
            _ if info.version > end => return Err(journal_is_short(info.version, end)),
            _ => tiles.remove(info.id)?,
        }
    }
    let stale = newest.iter().filter_map(|(id, newest)| {
        let version = versions.get(id).copied().unwrap_or(0);
        (version < *newest).then_some(version)
    });
    let folded = stale.min().unwrap_or(end);
    Ok(Resumed { tiles, sound, folded })
}

/// Opens the tiles of this journal. sled panics on some damaged files: that is caught here.
fn open(dir: &Path, cache_bytes: u64, journal: Uuid) -> Result<(Tiles, Vec<TileInfo>), String> {
    let attempt = || {
        let tiles = Tiles::open(dir, cache_bytes)?;
        match tiles.journal()? {
            Some(other) if other != journal => return Ok(None),
            Some(_) => {}
            None => tiles.set_journal(journal)?,
        }
        let sound = tiles.sound()?;
        Ok(Some((tiles, sound)))
    };
    match catch_unwind(AssertUnwindSafe(attempt)) {
        Ok(Ok(Some(opened))) => Ok(opened),
        Ok(Ok(None)) => Err("they were folded from another journal".to_owned()),
        Ok(Err(error)) => Err(Error::to_string(&error)),
        Err(_) => Err("opening them panicked".to_owned()),
    }
}

/// Renames the tiles away, for whoever wants to look; only the last such copy is kept.
fn put_aside(dir: &Path) -> Result<(), Error> {
    let aside = dir.with_extension("damaged");
    if aside.exists() {
        std::fs::remove_dir_all(&aside).map_err(io_error("removing older damaged tiles"))?;
    }
    std::fs::rename(dir, aside).map_err(io_error("putting damaged tiles aside"))
}

/// Tiles are folded from records on disk only, so the journal has lost some.
fn journal_is_short(version: u64, end: u64) -> Error {
    Error::Damaged {
        what: "the journal".to_owned(),
        reason: format!(
            "it ends at upload {end} but the tiles hold upload {version}: acknowledged uploads are missing. \
             Restore the journal, or delete the tiles to go on without them"
        ),
    }
}

/// Folds until the end is called.
pub(super) fn run(shared: &Shared) {
    let whole = shared.index.newest();
    let mut folded = shared.progress.borrow().epoch;
    let mut told = Instant::now();
    if folded < whole {
        tracing::info!(folded, journaled = whole, "folding the journal into tiles");
    }
    if folded >= whole {
        shared.set_state(State::Serving);
    }
    loop {
        let Some(group) = shared.index.after(folded) else { return };
        match caught(|| fold(shared, &group)) {
            Ok(newest) => {
                folded = newest;
                shared.progress.send_modify(|progress| progress.epoch = folded);
                if folded >= whole {
                    shared.set_state(State::Serving);
                }
            }
            Err(reason) => {
                tracing::error!(reason, "folding failed; trying again");
                if folded >= whole {
                    shared.set_state(State::Stalled);
                }
                if !shared.index.pause(RETRY) {
                    return;
                }
            }
        }
        if folded < whole && told.elapsed() > Duration::from_secs(1) {
            tracing::info!(folded, journaled = whole, "folding the journal into tiles");
            told = Instant::now();
        }
    }
}

/// The outcome of work that may panic, as sled does on some damaged files. Folding is done again from
/// what is stored, so nothing half done in memory is used.
fn caught(work: impl FnOnce() -> Result<u64, Error>) -> Result<u64, String> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(outcome) => outcome.map_err(|error| error.to_string()),
        Err(_) => Err("it panicked".to_owned()),
    }
}

/// Folds a group of uploads, each tile read and written once. Returns the last one's number.
fn fold(shared: &Shared, group: &[Written]) -> Result<u64, Error> {
    let mut reader = shared.journal.reader();
    let mut uploads = Vec::with_capacity(group.len());
    for written in group {
        let payload = reader.payload(written.at)?;
        uploads.push((written.number, decode(written.number, &payload)?));
    }
    let mut by_tile: BTreeMap<TileId, Vec<(u64, &Upload)>> = BTreeMap::new();
    for (number, upload) in &uploads {
        for id in upload.contribution.tiles.keys() {
            by_tile.entry(*id).or_default().push((*number, upload));
        }
    }
    for (id, uploads) in by_tile {
        let mut folded = shared.tiles.folded(id)?;
        let before = folded.version;
        for (number, upload) in uploads.into_iter().filter(|(number, _)| *number > before) {
            folded.ledger.forget_before(upload.forget_before);
            folded.tile.fold(&mut folded.ledger, upload.pass, &upload.contribution.tiles[&id]);
            folded.version = number;
        }
        if folded.version > before {
            let info = shared.tiles.put(id, &folded)?;
            shared.catalog_mut().put(info);
        }
    }
    Ok(uploads.last().map_or(0, |(number, _)| *number))
}

fn decode(number: u64, payload: &[u8]) -> Result<Upload, Error> {
    record::decode(payload).ok_or_else(|| unreadable(number))
}

/// A record whose checksum matches but whose content does not follow the format.
pub(super) fn unreadable(number: u64) -> Error {
    let reason = "its content does not follow the format; a newer version may have written it".to_owned();
    Error::Damaged { what: format!("journal record {number}"), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_a_failure_like_any_other() {
        assert_eq!(caught(|| Ok(7)), Ok(7));
        assert!(caught(|| Err(unreadable(3))).unwrap_err().contains("record 3"));
        assert_eq!(caught(|| panic!("a damaged page")), Err("it panicked".to_owned()));
    }
}
