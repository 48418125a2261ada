//! The checkpoint: the map as of a record, without any memory of who made it. It stands for the records up to
//! that one, which are deleted once it is on disk.
//!
//! ```text
//! magic "EFB" 1 (4) | journal id (16) | last record (8) | uploads in it (8) | tiles (8) | tiles | trailer
//! ```
//!
//! See [`crate::store::map::stream`]; the numbers are little-endian.

use std::io::{self, Read, Write};

use echofix_core::geo::TileId;
use uuid::Uuid;

use super::stream::{ChecksummedReader, ChecksummedWriter, bad};
use crate::store::api::{Error, io_error};
use crate::store::backend::objects::{Objects, reader};

const MAGIC: [u8; 4] = *b"EFB\x01";
/// How the names of checkpoints begin.
const PREFIX: &str = "base-";

/// A checkpoint that is sound, or the emptiness before the first record.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(in crate::store) struct Checkpoint {
    /// `None` for the emptiness.
    pub(in crate::store) name: Option<String>,
    /// The last record in it.
    pub(in crate::store) last: u64,
    /// Uploads in it.
    pub(in crate::store) uploads: u64,
}

impl Checkpoint {
    /// The newest sound checkpoint of a journal.
    pub(in crate::store) fn newest(objects: &dyn Objects, journal: Uuid) -> Result<Self, Error> {
        let mut newest = Self::default();
        for name in names(objects)? {
            match read(objects, &name, |_, _, _| Ok(())) {
                Ok((of, checkpoint)) if of == journal && checkpoint.last > newest.last => newest = checkpoint,
                Ok(_) => {}
                Err(error) => {
                    tracing::warn!(path = objects.locate(&name), %error, "a checkpoint cannot be used");
                }
            }
        }
        Ok(newest)
    }

    /// Writes a checkpoint, durably, under a name that nothing has, whoever made it.
    pub(in crate::store) fn write(
        objects: &dyn Objects,
        journal: Uuid,
        (last, uploads): (u64, u64),
        tiles: &[TileId],
        mut tile: impl FnMut(TileId) -> Result<(u64, Vec<u8>), Error>,
    ) -> Result<Self, Error> {
        let mut failure = None;
        let mut put = |out: &mut dyn Write| {
            let mut out = ChecksummedWriter::new(out);
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
        };
        let written = put_under_free_name(objects, last, &mut put);
        match failure {
            Some(error) => Err(error),
            None => {
                Ok(Self { name: Some(written.map_err(io_error("writing the checkpoint"))?), last, uploads })
            }
        }
    }

    /// Visits all tiles: id, version, encoded bytes.
    ///
    /// # Errors
    /// When the backend refuses or the checkpoint is no longer sound; what was visited is void then.
    pub(in crate::store) fn visit(
        &self,
        objects: &dyn Objects,
        each: impl FnMut(TileId, u64, Vec<u8>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let Some(name) = &self.name else { return Ok(()) };
        read(objects, name, each).map(|_| ())
    }

    /// Deletes the sound checkpoints of the journal that this one continues. What is damaged, or of another journal, stays
    /// for whoever runs the store.
    pub(in crate::store) fn remove_others(&self, objects: &dyn Objects, journal: Uuid) -> Result<(), Error> {
        for name in names(objects)?.into_iter().filter(|name| Some(name) != self.name.as_ref()) {
            match read(objects, &name, |_, _, _| Ok(())) {
                Ok((of, older)) if of == journal && older.last <= self.last => {
                    objects.delete(&name).map_err(io_error("removing an older checkpoint"))?;
                }
                _ => {
                    let path = objects.locate(&name);
                    tracing::warn!(path, "no sound checkpoint of this journal; left alone");
                }
            }
        }
        Ok(())
    }
}

/// Puts a checkpoint under the first name that is free. That a list names it not does not say that it is.
fn put_under_free_name(
    objects: &dyn Objects,
    last: u64,
    put: &mut dyn FnMut(&mut dyn Write) -> io::Result<()>,
) -> io::Result<String> {
    let first = format!("{PREFIX}{last}");
    let taken = objects.list(&first)?;
    let others = (2..u32::MAX).map(|count| format!("{first}.{count}"));
    for name in std::iter::once(first.clone()).chain(others).filter(|name| !taken.contains(name)) {
        match objects.put_new(&name, put) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            outcome => return outcome.map(|()| name),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// Journal, last record and number of tiles of a checkpoint; every byte is checked.
///
/// # Errors
/// When it is damaged.
pub(in crate::store) fn checked(what: &str, bytes: &[u8]) -> Result<(Uuid, u64, u64), Error> {
    let mut tiles = 0;
    let damaged = |error: io::Error| Error::Damaged { what: what.to_owned(), reason: error.to_string() };
    let count = |_, _, _| {
        tiles += 1;
        Ok(())
    };
    let (journal, last, _) = parsed(bytes, damaged, count)?;
    Ok((journal, last, tiles))
}

fn read(
    objects: &dyn Objects,
    name: &str,
    each: impl FnMut(TileId, u64, Vec<u8>) -> Result<(), Error>,
) -> Result<(Uuid, Checkpoint), Error> {
    let failed = |error: io::Error| match error.kind() {
        io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof => {
            let what = format!("the checkpoint {}", objects.locate(name));
            Error::Damaged { what, reason: error.to_string() }
        }
        _ => io_error("reading the checkpoint")(error),
    };
    let opened = objects.open(name).and_then(reader).map_err(failed)?;
    let (journal, last, uploads) = parsed(opened, failed, each)?;
    Ok((journal, Checkpoint { name: Some(name.to_owned()), last, uploads }))
}

/// Journal, last record and uploads of a checkpoint; its tiles are visited.
fn parsed(
    input: impl Read,
    failed: impl Fn(io::Error) -> Error,
    mut each: impl FnMut(TileId, u64, Vec<u8>) -> Result<(), Error>,
) -> Result<(Uuid, u64, u64), Error> {
    let failed = &failed;
    let mut input = ChecksummedReader::new(input);
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
    Ok((journal, last, uploads))
}

/// What has the name of a checkpoint.
fn names(objects: &dyn Objects) -> Result<Vec<String>, Error> {
    let mut names = objects.list(PREFIX).map_err(io_error("listing the checkpoints"))?;
    names.retain(|name| {
        let number = name.strip_prefix(PREFIX).unwrap_or_default();
        let (last, count) = number.split_once('.').unwrap_or((number, "2"));
        last.parse::<u64>().is_ok() && count.parse::<u32>().is_ok()
    });
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::backend::memory::Memory;
    use echofix_core::geo::Zone;

    #[test]
    fn the_newest_sound_checkpoint_of_the_journal_counts() {
        let objects = &*Memory::default().open().objects;
        let put = |name: &str, bytes: &[u8]| {
            objects.delete(name).unwrap();
            objects.put_new(name, &mut |out| out.write_all(bytes)).unwrap();
        };
        let (ours, theirs) = (Uuid::from_u128(1), Uuid::from_u128(2));
        let id = |x| TileId { zone: Zone::from_epsg(32614).unwrap(), y: -2, x };
        let tiles = [id(1), id(2)];
        let write = |journal, last| {
            let tile = |id: TileId| Ok((3, vec![id.x as u8; 5]));
            Checkpoint::write(objects, journal, (last, 2), &tiles, tile).unwrap()
        };
        assert_eq!(Checkpoint::newest(objects, ours).unwrap(), Checkpoint::default());
        let (older, newer) = (write(ours, 5), write(ours, 9));
        write(theirs, 11);
        assert_eq!(Checkpoint::newest(objects, ours).unwrap(), newer);
        let mut seen = Vec::new();
        newer
            .visit(objects, |id, version, encoded| {
                seen.push((id, version, encoded));
                Ok(())
            })
            .unwrap();
        assert_eq!(seen, [(id(1), 3, vec![1; 5]), (id(2), 3, vec![2; 5])]);

        let name = newer.name.clone().unwrap();
        let mut good = Vec::new();
        reader(objects.open(&name).unwrap()).unwrap().read_to_end(&mut good).unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 8;
            put(&name, &bad);
            assert_eq!(Checkpoint::newest(objects, ours).unwrap(), older, "byte {at}");
            put(&name, &good[..at]);
            assert_eq!(Checkpoint::newest(objects, ours).unwrap(), older, "cut at {at}");
        }
        put(&name, &good);
        put("base-3", b"a bass line");
        newer.remove_others(objects, ours).unwrap();
        assert_eq!(names(objects).unwrap(), ["base-11", "base-3", "base-9"], "only what is replaced goes");
        assert_eq!(write(ours, 3).name.as_deref(), Some("base-3.2"), "nothing is overwritten");
    }
}
