//! Tiles in a [`TileLog`], which is not trusted: every tile carries its own checksum, and with every change goes,
//! in one put, how far the journal is folded and a digest of all tiles' versions. Tiles that were lost, or kept from
//! another time, are noticed by it; then all are folded again.
//!
//! ```text
//! key    see [`super::key`]
//! value  CRC-32C of key and the rest (4) | version (8) | cells served (4) | newest day (2) | tile length (4) | tile | ledger
//! a quarantined upload: see [`super::quarantine`]
//! state  CRC-32C of the rest (4) | number of the last record folded (8) | digest (8)
//! ```

use std::path::Path;

use echofix_core::geo::TileId;
use echofix_core::tile::{self, Tile};
use uuid::Uuid;

use super::canvas::{Folded, Source};
use super::catalog::Catalog;
use super::key::{id_of, key};
use super::tile_log::TileLog;
use super::vetting::Quarantined;
use super::{Error, TileInfo, quarantine};

/// Where it is kept how far the tiles go.
pub(super) const STATE: &[u8] = b"state";
const HEAD: usize = 22;

/// The tile store.
pub(super) struct Tiles {
    pub(super) log: TileLog,
}

impl Tiles {
    /// An empty store, of what is folded from a journal.
    pub(super) fn create(dir: &Path, journal: Uuid) -> Result<Self, Error> {
        Ok(Self { log: TileLog::create(dir, journal)? })
    }

    /// A store as it was left.
    pub(super) fn open(dir: &Path, journal: Uuid) -> Result<Self, Error> {
        Ok(Self { log: TileLog::open(dir, journal)? })
    }

    /// All tiles and how far they are folded; `Err` says what is wrong with them. Nothing is folded meanwhile.
    pub(super) fn check(&self) -> Result<(Catalog, u64), String> {
        let _unchanged = self.log.paused();
        let mut catalog = Catalog::default();
        let mut state = None;
        for key in self.log.keys(&[]) {
            let value = self.log.get(&key).map_err(|error| error.to_string())?.unwrap_or_default();
            if let Some(id) = id_of(&key) {
                catalog.put(parse(id, &value).map_err(|error| error.to_string())?.info);
            } else if key == STATE {
                state = Some(parse_state(&value).ok_or("how far they are folded is damaged")?);
            } else if !quarantine::is_key(&key) {
                return Err(format!("nobody knows what {key:?} is"));
            }
        }
        match state {
            None => Err("it is not said how far they are folded".to_owned()),
            Some((folded, digest)) if digest == catalog.digest() => Ok((catalog, folded)),
            Some(_) => Err("some are missing or older than the others".to_owned()),
        }
    }

    /// Version and evidence of a tile.
    pub(super) fn stored(&self, id: TileId) -> Result<Option<(u64, Tile)>, Error> {
        let Some(value) = self.value(id)? else { return Ok(None) };
        let value = parse(id, &value)?;
        let tile = tile::decode(value.tile).map_err(|e| damaged(id, &e))?;
        Ok(Some((value.info.version, tile)))
    }

    /// Version and encoded bytes of a tile.
    pub(super) fn raw(&self, id: TileId) -> Result<Option<(u64, Vec<u8>)>, Error> {
        let Some(value) = self.value(id)? else { return Ok(None) };
        let value = parse(id, &value)?;
        Ok(Some((value.info.version, value.tile.to_vec())))
    }

    /// Puts tiles, what was kept out of them, and how far they go with them, all or none.
    pub(super) fn put_all(
        &self,
        values: Vec<Value>,
        quarantined: &[Quarantined],
        folded: u64,
        digest: u64,
    ) -> Result<(), Error> {
        let mut entries: Vec<_> =
            values.into_iter().map(|Value { bytes, info }| (key(info.id).to_vec(), bytes)).collect();
        let notes = quarantined.iter();
        entries.extend(notes.map(|note| (quarantine::key(note.number), quarantine::encode(note))));
        entries.push((STATE.to_vec(), state(folded, digest)));
        self.log.put(&entries)
    }

    /// The uploads that were kept out, oldest first.
    pub(super) fn quarantined(&self) -> Result<Vec<Quarantined>, Error> {
        let damaged = || Error::Damaged {
            what: "a note of a quarantined upload".to_owned(),
            reason: "its checksum does not match".to_owned(),
        };
        let notes = self.log.keys(quarantine::PREFIX).into_iter().map(|key| {
            let value = self.log.get(&key)?.unwrap_or_default();
            quarantine::decode(&key, &value).ok_or_else(damaged)
        });
        notes.collect()
    }

    /// Brings everything to disk.
    pub(super) fn flush(&self) -> Result<(), Error> {
        self.log.flush()
    }

    fn value(&self, id: TileId) -> Result<Option<Vec<u8>>, Error> {
        self.log.get(&key(id))
    }
}

impl Source for Tiles {
    fn folded(&self, id: TileId) -> Result<Folded, Error> {
        let Some(value) = self.value(id)? else { return Ok(Folded::default()) };
        let value = parse(id, &value)?;
        let tile = tile::decode(value.tile).map_err(|e| damaged(id, &e))?;
        let ledger = tile::decode_ledger(value.ledger).map_err(|e| damaged(id, &e))?;
        Ok(Folded { version: value.info.version, tile, ledger })
    }
}

/// A tile in the bytes it is stored in.
pub(super) struct Value {
    bytes: Vec<u8>,
    pub(super) info: TileInfo,
}

impl Value {
    /// Of its cells those count that are served when `publish` contributors are asked for.
    pub(super) fn new(id: TileId, folded: &Folded, publish: u8) -> Self {
        let encoded = tile::encode(&folded.tile);
        let info = TileInfo {
            id,
            version: folded.version,
            cells: folded.tile.supported(publish).count() as u32,
            newest_day: folded.tile.newest_day(),
            bytes: encoded.len() as u32,
        };
        let mut bytes = vec![0; 4];
        bytes.extend_from_slice(&info.version.to_le_bytes());
        bytes.extend_from_slice(&info.cells.to_le_bytes());
        bytes.extend_from_slice(&info.newest_day.to_le_bytes());
        bytes.extend_from_slice(&info.bytes.to_le_bytes());
        bytes.extend_from_slice(&encoded);
        bytes.extend_from_slice(&tile::encode_ledger(&folded.ledger));
        let checksum = checksum(&key(id), &bytes);
        bytes[..4].copy_from_slice(&checksum.to_le_bytes());
        Self { bytes, info }
    }
}

fn state(folded: u64, digest: u64) -> Vec<u8> {
    let mut bytes = vec![0; 4];
    bytes.extend_from_slice(&folded.to_le_bytes());
    bytes.extend_from_slice(&digest.to_le_bytes());
    let checksum = checksum(STATE, &bytes);
    bytes[..4].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

fn parse_state(bytes: &[u8]) -> Option<(u64, u64)> {
    let bytes: &[u8; 20] = bytes.try_into().ok()?;
    let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
    let (folded, digest) = (word(4), word(12));
    (state(folded, digest) == bytes).then_some((folded, digest))
}

/// A value whose checksum matches.
struct Parsed<'a> {
    info: TileInfo,
    tile: &'a [u8],
    ledger: &'a [u8],
}

fn parse(id: TileId, value: &[u8]) -> Result<Parsed<'_>, Error> {
    parse_sound(id, value).ok_or_else(|| damaged(id, &"its checksum does not match"))
}

fn parse_sound(id: TileId, value: &[u8]) -> Option<Parsed<'_>> {
    let (head, body) = value.split_at_checked(HEAD)?;
    if checksum(&key(id), value).to_le_bytes() != head[..4] {
        return None;
    }
    let info = TileInfo {
        id,
        version: u64::from_le_bytes(head[4..12].try_into().ok()?),
        cells: u32::from_le_bytes(head[12..16].try_into().ok()?),
        newest_day: u16::from_le_bytes(head[16..18].try_into().ok()?),
        bytes: u32::from_le_bytes(head[18..22].try_into().ok()?),
    };
    let (tile, ledger) = body.split_at_checked(info.bytes as usize)?;
    Some(Parsed { info, tile, ledger })
}

/// The key is part of the sum: a sound value under another tile's key is damage too.
fn checksum(key: &[u8], value: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(key), &value[4..])
}

fn damaged(id: TileId, reason: &dyn std::fmt::Display) -> Error {
    Error::Damaged { what: format!("tile {id}"), reason: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::super::key::stamp;
    use super::*;
    use echofix_core::geo::Zone;
    use proptest::prelude::*;

    fn id(x: i32) -> TileId {
        TileId { zone: Zone::from_epsg(32614).unwrap(), y: 2, x }
    }

    fn value(x: i32, version: u64) -> Value {
        Value::new(id(x), &Folded { version, ..Folded::default() }, 1)
    }

    fn opened(dir: &Path) -> Tiles {
        Tiles::open(dir, Uuid::nil()).unwrap()
    }

    proptest! {
        // Breaks it: leaving a part of the value out of the checksum.
        #[test]
        fn a_changed_or_cut_value_is_noticed(at: prop::sample::Index, bit in 0..8_u8, of_state: bool) {
            let dir = tempfile::tempdir().unwrap();
            let tiles = Tiles::create(dir.path(), Uuid::nil()).unwrap();
            let value = value(-1, 3);
            let digest = stamp(&value.info);
            tiles.put_all(vec![value], &[], 3, digest).unwrap();
            prop_assert_eq!(tiles.check().unwrap().1, 3);
            let key = if of_state { STATE.to_vec() } else { key(id(-1)).to_vec() };
            let good = tiles.log.get(&key).unwrap().unwrap();
            let at = at.index(good.len());
            let mut bad = good.clone();
            bad[at] ^= 1_u8 << bit;
            for bad in [bad, good[..at].to_vec()] {
                tiles.log.put(&[(key.clone(), bad)]).unwrap();
                prop_assert!(tiles.check().is_err() && opened(dir.path()).check().is_err());
                let damaged = |error| matches!(error, Some(Error::Damaged { .. }));
                prop_assert!(of_state || damaged(tiles.stored(id(-1)).err()));
                prop_assert!(of_state || damaged(tiles.folded(id(-1)).err()));
            }
            tiles.log.put(&[(key, good)]).unwrap();
            prop_assert!(opened(dir.path()).check().is_ok());
        }
    }

    #[test]
    fn a_missing_or_older_tile_and_what_nobody_knows_are_noticed() {
        let dir = tempfile::tempdir().unwrap();
        let tiles = Tiles::create(dir.path(), Uuid::nil()).unwrap();
        assert!(tiles.check().is_err(), "it is not said how far they go");
        let digest = stamp(&value(1, 3).info).wrapping_add(stamp(&value(2, 5).info));
        tiles.put_all(vec![value(2, 5)], &[], 5, digest).unwrap();
        assert!(tiles.check().is_err());
        tiles.put_all(vec![value(1, 3)], &[], 5, digest).unwrap();
        assert!(tiles.check().is_ok());
        tiles.put_all(vec![value(1, 2)], &[], 5, digest).unwrap();
        assert!(tiles.check().is_err());
        tiles.put_all(vec![value(1, 3)], &[], 5, digest).unwrap();
        tiles.log.put(&[(b"stray".to_vec(), b"value".to_vec())]).unwrap();
        assert!(tiles.check().is_err());
    }
}
