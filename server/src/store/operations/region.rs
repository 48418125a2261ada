//! A region's map as one portable file, and its way into another map.
//!
//! ```text
//! magic "EFX" 1 (4) | id (16) | west, south, east, north (8 each, degrees) | epoch (8) | tiles (8) | tiles | trailer
//! ```
//!
//! See [`crate::store::map::stream`]; little-endian. Contributors are not in it: tiles know how many there were, not who.

use std::io::{self, Read, Write};

use echofix_core::geo::TileId;
use echofix_core::tile;
use uuid::Uuid;

use crate::store::backend::objects::{Objects, reader};

use crate::store::api::{Error, Imported, Region, io_error};
use crate::store::log::entry;
use crate::store::log::sequencer::NewRecord;
use crate::store::map::context::StoreContext;
use crate::store::map::stream::{ChecksummedReader, ChecksummedWriter, bad};

const MAGIC: [u8; 4] = *b"EFX\x01";
/// Tiles that go to the journal together.
const GROUP: usize = 64;

struct Header {
    file: Uuid,
    /// Of the map that it was written from.
    epoch: u64,
    tiles: u64,
}

/// Bytes of a file's id that tell whose it is.
const WHOSE: std::ops::Range<usize> = 10..16;

/// A new id, which tells this history of the map from others.
fn own_file(shared: &StoreContext) -> Uuid {
    let mut id = Uuid::now_v7().into_bytes();
    id[WHOSE].copy_from_slice(&history(shared));
    Uuid::from_bytes(id)
}

fn history(shared: &StoreContext) -> [u8; 6] {
    let bytes = [&shared.journal_id.into_bytes()[..], &shared.lineage.to_le_bytes()].concat();
    let [a, b, c, d, e, f, ..] = siphasher::sip::SipHasher24::new().hash(&bytes).to_le_bytes();
    [a, b, c, d, e, f]
}

/// Does the map hold all that a file holds? It does where the file was written from this history, and nothing was excluded since.
fn holds_all_of(shared: &StoreContext, header: &Header) -> bool {
    header.file.into_bytes()[WHOSE] == history(shared)
        && header.epoch <= shared.index.newest()
        && !shared.index.excluded_since(header.epoch)
}

pub(in crate::store) fn export(
    shared: &StoreContext,
    region: &Region,
    out: &mut dyn Write,
) -> Result<u64, Error> {
    let generation = shared.readable()?;
    let epoch = shared.progress.borrow().epoch;
    let mut tiles = region.tiles.clone();
    tiles.retain(|id| generation.catalog().get(*id).is_some());
    let written = |outcome: io::Result<()>| outcome.map_err(io_error("writing a region"));
    let mut out = ChecksummedWriter::new(out);
    written(out.put(&MAGIC))?;
    written(out.put(own_file(shared).as_bytes()))?;
    for degrees in region.bounds_deg {
        written(out.put(&degrees.to_le_bytes()))?;
    }
    written(out.put(&epoch.to_le_bytes()))?;
    written(out.put(&(tiles.len() as u64).to_le_bytes()))?;
    for id in &tiles {
        let lost = || Error::Damaged { what: format!("tile {id}"), reason: "it is gone".to_owned() };
        let (version, encoded) = generation.tiles.raw(*id)?.ok_or_else(lost)?;
        written(out.tile(*id, version, &encoded))?;
    }
    written(out.end())?;
    Ok(tiles.len() as u64)
}

pub(in crate::store) fn import(shared: &StoreContext, file: &mut dyn Read) -> Result<Imported, Error> {
    let received = ReceivedFile::of(&*shared.backend.objects, file)?;
    // All of it is checked before any of it counts.
    let header = read(&received, |_, _, _| Ok(()))?;
    let _deciding = shared.decide();
    if holds_all_of(shared, &header) {
        let Header { file, tiles, .. } = header;
        return Ok(Imported { file, tiles, known: tiles, epoch: shared.index.newest() });
    }
    let (mut group, mut known) = (Vec::with_capacity(GROUP), 0);
    let mut epoch = shared.index.newest();
    let mut write = |group: &mut Vec<_>| {
        let written = shared.journal.submit(std::mem::take(group));
        let written = written.inspect_err(|error| shared.note_stop(error))?;
        epoch = written.last().map_or(epoch, |last| last.written.number);
        Ok::<_, Error>(())
    };
    read(&received, |file, id, encoded| {
        if shared.index.imported(file, id) {
            known += 1;
            return Ok(());
        }
        let (meta, payload) = entry::import(shared.settings.clock.today(), file, id, &encoded);
        group.push(NewRecord { meta, fresh: false, payload, number: None });
        if group.len() == GROUP { write(&mut group) } else { Ok(()) }
    })?;
    write(&mut group)?;
    Ok(Imported { file: header.file, tiles: header.tiles, known, epoch })
}

/// A file that is read twice; removed when dropped.
struct ReceivedFile<'a> {
    objects: &'a dyn Objects,
    name: String,
}

impl<'a> ReceivedFile<'a> {
    fn of(objects: &'a dyn Objects, file: &mut dyn Read) -> Result<Self, Error> {
        let received = Self { objects, name: format!("import-{}.new", Uuid::now_v7()) };
        let put = objects.put_new(&received.name, &mut |out| io::copy(file, out).map(drop));
        put.map_err(io_error("receiving a region"))?;
        Ok(received)
    }
}

impl Drop for ReceivedFile<'_> {
    fn drop(&mut self) {
        if let Err(error) = self.objects.delete(&self.name) {
            let path = self.objects.locate(&self.name);
            tracing::warn!(path, %error, "a received region could not be removed");
        }
    }
}

fn read(
    received: &ReceivedFile<'_>,
    mut each: impl FnMut(Uuid, TileId, Vec<u8>) -> Result<(), Error>,
) -> Result<Header, Error> {
    let failed = |error: io::Error| match error.kind() {
        io::ErrorKind::InvalidData => Error::Unusable(format!("this is no whole file of a region: {error}")),
        io::ErrorKind::UnexpectedEof => Error::Unusable("the file of the region ends too early".to_owned()),
        _ => io_error("reading a region")(error),
    };
    let opened = received.objects.open(&received.name).and_then(reader).map_err(failed)?;
    let mut input = ChecksummedReader::new(opened);
    if input.array().map_err(failed)? != MAGIC {
        return Err(failed(bad("it does not begin as one")));
    }
    let file = Uuid::from_bytes(input.array().map_err(failed)?);
    let _bounds: [u8; 32] = input.array().map_err(failed)?;
    let epoch = input.number().map_err(failed)?;
    let tiles = input.number().map_err(failed)?;
    for _ in 0..tiles {
        let (id, _, encoded) = input.tile().map_err(failed)?;
        let unsound = |error| Error::Unusable(format!("tile {id} in the file of the region: {error}"));
        tile::decode(&encoded).map_err(unsound)?;
        each(file, id, encoded)?;
    }
    input.end().map_err(failed)?;
    Ok(Header { file, epoch, tiles })
}
