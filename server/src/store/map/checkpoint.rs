//! The checkpoint: the map as of a record, without any memory of who made it. It stands for the records up to
//! that one, which are deleted once it is on disk.
//!
//! ```text
//! magic "EFB" 1 (4) | journal id (16) | last record (8) | uploads in it (8) | tiles (8) | tiles | trailer
//! ```
//!
//! See [`crate::store::map::stream`]; the numbers are little-endian.

use std::fs::{self, File};
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use echofix_core::geo::TileId;
use uuid::Uuid;

use super::stream::{ChecksummedReader, ChecksummedWriter, bad};
use crate::store::api::{Error, io_error};
use crate::store::local::files::put_file;

const MAGIC: [u8; 4] = *b"EFB\x01";

/// A checkpoint that is sound, or the emptiness before the first record.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(in crate::store) struct Checkpoint {
    /// `None` for the emptiness.
    pub(in crate::store) path: Option<PathBuf>,
    /// The last record in it.
    pub(in crate::store) last: u64,
    /// Uploads in it.
    pub(in crate::store) uploads: u64,
}

impl Checkpoint {
    /// The newest sound checkpoint of a journal in a directory.
    pub(in crate::store) fn newest(root: &Path, journal: Uuid) -> Result<Self, Error> {
        let mut newest = Self::default();
        for path in files(root)? {
            match read(&path, |_, _, _| Ok(())) {
                Ok((of, checkpoint)) if of == journal && checkpoint.last > newest.last => newest = checkpoint,
                Ok(_) => {}
                Err(error) => tracing::warn!(path = %path.display(), %error, "a checkpoint cannot be used"),
            }
        }
        Ok(newest)
    }

    /// Writes a checkpoint and brings it to disk.
    pub(in crate::store) fn write(
        root: &Path,
        journal: Uuid,
        (last, uploads): (u64, u64),
        tiles: &[TileId],
        mut tile: impl FnMut(TileId) -> Result<(u64, Vec<u8>), Error>,
    ) -> Result<Self, Error> {
        let name = free_name(root, last);
        let mut failure = None;
        let written = put_file(root, &name, |file| {
            let mut out = ChecksummedWriter::new(file);
            out.put(&MAGIC)?;
            out.put(journal.as_bytes())?;
            for number in [last, uploads, tiles.len() as u64] {
                out.put(&number.to_le_bytes())?;
            }
            for id in tiles {
                match tile(*id) {
                    Ok((version, encoded)) => out.tile(*id, version, &encoded)?,
                    Err(error) => {
                        failure = Some(error);
                        return Err(bad("a tile cannot be read"));
                    }
                }
            }
            out.end()
        });
        match failure {
            Some(error) => Err(error),
            None => written.map_err(io_error("writing the checkpoint")),
        }?;
        Ok(Self { path: Some(root.join(name)), last, uploads })
    }

    /// Visits all tiles: id, version, encoded bytes.
    ///
    /// # Errors
    /// When the disk refuses or the file is no longer sound; what was visited is void then.
    pub(in crate::store) fn visit(
        &self,
        each: impl FnMut(TileId, u64, Vec<u8>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let Some(path) = &self.path else { return Ok(()) };
        read(path, each).map(|_| ())
    }

    /// Deletes the sound checkpoints of the journal that this one continues. What is damaged, or of another journal, stays
    /// for whoever runs the store.
    pub(super) fn remove_others(&self, root: &Path, journal: Uuid) -> Result<(), Error> {
        for path in files(root)?.into_iter().filter(|path| Some(path) != self.path.as_ref()) {
            match read(&path, |_, _, _| Ok(())) {
                Ok((of, older)) if of == journal && older.last <= self.last => {
                    fs::remove_file(path).map_err(io_error("removing an older checkpoint"))?;
                }
                _ => {
                    tracing::warn!(path = %path.display(), "no sound checkpoint of this journal; left alone");
                }
            }
        }
        Ok(())
    }
}

/// A name that nothing has, whoever made it.
fn free_name(root: &Path, last: u64) -> String {
    let names = (1..).map(|count| match count {
        1 => format!("base-{last}"),
        count => format!("base-{last}.{count}"),
    });
    let mut free = names.filter(|name| root.join(name).symlink_metadata().is_err());
    free.next().unwrap_or_else(|| format!("base-{last}"))
}

fn read(
    path: &Path,
    mut each: impl FnMut(TileId, u64, Vec<u8>) -> Result<(), Error>,
) -> Result<(Uuid, Checkpoint), Error> {
    let failed = |error: io::Error| match error.kind() {
        io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof => {
            Error::Damaged { what: format!("the checkpoint {}", path.display()), reason: error.to_string() }
        }
        _ => io_error("reading the checkpoint")(error),
    };
    let mut input = ChecksummedReader::new(BufReader::new(File::open(path).map_err(failed)?));
    if input.array().map_err(failed)? != MAGIC {
        return Err(failed(bad("it is no checkpoint")));
    }
    let journal = Uuid::from_bytes(input.array().map_err(failed)?);
    let mut number = || input.number().map_err(failed);
    let (last, uploads, tiles) = (number()?, number()?, number()?);
    for _ in 0..tiles {
        let (id, version, encoded) = input.tile().map_err(failed)?;
        each(id, version, encoded)?;
    }
    input.end().map_err(failed)?;
    Ok((journal, Checkpoint { path: Some(path.to_owned()), last, uploads }))
}

fn files(root: &Path) -> Result<Vec<PathBuf>, Error> {
    let listing = "listing the data directory";
    let mut files = Vec::new();
    for entry in fs::read_dir(root).map_err(io_error(listing))? {
        let entry = entry.map_err(io_error(listing))?;
        let name = entry.file_name();
        let number = name.to_str().and_then(|name| name.strip_prefix("base-"));
        let numbers = number.map(|number| number.split_once('.').unwrap_or((number, "2")));
        let is_one =
            |(last, count): (&str, &str)| last.parse::<u64>().is_ok() && count.parse::<u32>().is_ok();
        if numbers.is_some_and(is_one) && entry.path().is_file() {
            files.push(entry.path());
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::geo::Zone;

    #[test]
    fn the_newest_sound_checkpoint_of_the_journal_counts() {
        let dir = tempfile::tempdir().unwrap();
        let (ours, theirs) = (Uuid::from_u128(1), Uuid::from_u128(2));
        let id = |x| TileId { zone: Zone::from_epsg(32614).unwrap(), y: -2, x };
        let tiles = [id(1), id(2)];
        let write = |journal, last| {
            let tile = |id: TileId| Ok((3, vec![id.x as u8; 5]));
            Checkpoint::write(dir.path(), journal, (last, 2), &tiles, tile).unwrap()
        };
        assert_eq!(Checkpoint::newest(dir.path(), ours).unwrap(), Checkpoint::default());
        let (older, newer) = (write(ours, 5), write(ours, 9));
        write(theirs, 11);
        assert_eq!(Checkpoint::newest(dir.path(), ours).unwrap(), newer);
        let mut seen = Vec::new();
        newer
            .visit(|id, version, encoded| {
                seen.push((id, version, encoded));
                Ok(())
            })
            .unwrap();
        assert_eq!(seen, [(id(1), 3, vec![1; 5]), (id(2), 3, vec![2; 5])]);

        let path = newer.path.clone().unwrap();
        let good = fs::read(&path).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 8;
            fs::write(&path, &bad).unwrap();
            assert_eq!(Checkpoint::newest(dir.path(), ours).unwrap(), older, "byte {at}");
            fs::write(&path, &good[..at]).unwrap();
            assert_eq!(Checkpoint::newest(dir.path(), ours).unwrap(), older, "cut at {at}");
        }
        fs::write(&path, &good).unwrap();
        let theirs = dir.path().join("base-11");
        fs::write(dir.path().join("base-3"), "a bass line").unwrap();
        newer.remove_others(dir.path(), ours).unwrap();
        let mut left = files(dir.path()).unwrap();
        left.sort();
        assert_eq!(left, [theirs, dir.path().join("base-3"), path], "only what is replaced goes");
        assert_eq!(write(ours, 3).path, Some(dir.path().join("base-3.2")), "nothing is overwritten");
    }
}
