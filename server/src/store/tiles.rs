//! Tiles in sled, which is not trusted: every value carries its own checksum and says how far the
//! journal is folded into it, so that whatever sled lost can be folded again.
//!
//! ```text
//! key    EPSG code (2) | y (4) | x (4), big-endian, signs flipped: neighbours sit together
//! value  CRC-32C of key and the rest (4) | version (8) | cells (4) | newest day (2) | tile length (4) | tile | ledger
//! ```

use std::path::Path;
use std::time::{Duration, Instant};

use bytes::Bytes;
use echofix_core::geo::{TileId, Zone};
use echofix_core::tile::{self, Ledger, Tile};
use sled::IVec;
use uuid::Uuid;

use super::{Error, StoredTile, TileInfo};

/// Where the journal the tiles were folded from is named.
const JOURNAL: &[u8] = b"journal";
const KEY: usize = 10;
const HEAD: usize = 22;
/// How long a dropped instance may take to let go.
const LOCK_WAIT: Duration = Duration::from_secs(10);

/// The tile store.
pub(super) struct Tiles {
    pub(super) db: sled::Db,
    pub(super) tree: sled::Tree,
}

/// A tile and what folding needs of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Folded {
    /// Number of the last upload folded in; 0 for none.
    pub(super) version: u64,
    pub(super) tile: Tile,
    pub(super) ledger: Ledger,
}

impl Tiles {
    pub(super) fn open(dir: &Path, cache_bytes: u64) -> Result<Self, Error> {
        let config = sled::Config::new().path(dir).cache_capacity(cache_bytes).mode(sled::Mode::LowSpace);
        let db = unlocked(&config)?;
        let tree = db.open_tree("tiles")?;
        Ok(Self { db, tree })
    }

    /// The journal these tiles were folded from; `None` in a new store.
    pub(super) fn journal(&self) -> Result<Option<Uuid>, Error> {
        Ok(self.db.get(JOURNAL)?.map(|bytes| Uuid::from_slice(&bytes).unwrap_or_default()))
    }

    pub(super) fn set_journal(&self, journal: Uuid) -> Result<(), Error> {
        self.db.insert(JOURNAL, &journal.as_bytes()[..])?;
        Ok(())
    }

    /// The catalog's entries of all sound tiles; removes whatever else it meets.
    pub(super) fn sound(&self) -> Result<Vec<TileInfo>, Error> {
        let mut sound = Vec::new();
        for entry in &self.tree {
            let (key, value) = entry?;
            if let Some(info) = parse(&key, &value).map(|value| value.info) {
                sound.push(info);
            } else {
                tracing::warn!(key = ?&key[..], "a stored tile is damaged; folding it again");
                self.tree.remove(key)?;
            }
        }
        Ok(sound)
    }

    pub(super) fn remove(&self, id: TileId) -> Result<(), Error> {
        self.tree.remove(key(id))?;
        Ok(())
    }

    /// The tile as it is served.
    pub(super) fn stored(&self, id: TileId) -> Result<Option<StoredTile>, Error> {
        let Some((key, value)) = self.value(id)? else { return Ok(None) };
        let value = parse(&key, &value).ok_or_else(|| damaged(id, &"its checksum does not match"))?;
        let tile = tile::decode(value.tile).map_err(|e| damaged(id, &e))?;
        let encoded = Bytes::copy_from_slice(value.tile);
        Ok(Some(StoredTile { version: value.info.version, tile: tile.into(), encoded }))
    }

    /// The tile as it is folded on; empty where there is none.
    pub(super) fn folded(&self, id: TileId) -> Result<Folded, Error> {
        let Some((key, value)) = self.value(id)? else { return Ok(Folded::default()) };
        let value = parse(&key, &value).ok_or_else(|| damaged(id, &"its checksum does not match"))?;
        let tile = tile::decode(value.tile).map_err(|e| damaged(id, &e))?;
        let ledger = tile::decode_ledger(value.ledger).map_err(|e| damaged(id, &e))?;
        Ok(Folded { version: value.info.version, tile, ledger })
    }

    pub(super) fn put(&self, id: TileId, folded: &Folded) -> Result<TileInfo, Error> {
        let (key, encoded) = (key(id), tile::encode(&folded.tile));
        let info = TileInfo {
            id,
            version: folded.version,
            cells: folded.tile.len() as u32,
            newest_day: folded.tile.newest_day(),
            bytes: encoded.len() as u32,
        };
        let mut value = vec![0; 4];
        value.extend_from_slice(&info.version.to_le_bytes());
        value.extend_from_slice(&info.cells.to_le_bytes());
        value.extend_from_slice(&info.newest_day.to_le_bytes());
        value.extend_from_slice(&info.bytes.to_le_bytes());
        value.extend_from_slice(&encoded);
        value.extend_from_slice(&tile::encode_ledger(&folded.ledger));
        let checksum = checksum(&key, &value);
        value[..4].copy_from_slice(&checksum.to_le_bytes());
        self.tree.insert(key, value)?;
        Ok(info)
    }

    fn value(&self, id: TileId) -> Result<Option<([u8; KEY], IVec)>, Error> {
        let key = key(id);
        Ok(self.tree.get(key)?.map(|value| (key, value)))
    }
}

/// Opens sled, waiting while an instance of this process that was just dropped still holds it: its
/// threads end a little later. No other process has it, see [`super::data_dir`].
fn unlocked(config: &sled::Config) -> Result<sled::Db, sled::Error> {
    let began = Instant::now();
    loop {
        match config.open() {
            Err(sled::Error::Io(error))
                if error.to_string().contains("could not acquire lock") && began.elapsed() < LOCK_WAIT =>
            {
                std::thread::sleep(Duration::from_millis(5));
            }
            outcome => return outcome,
        }
    }
}

/// A value whose checksum matches.
struct Value<'a> {
    info: TileInfo,
    tile: &'a [u8],
    ledger: &'a [u8],
}

fn parse<'a>(key: &[u8], value: &'a [u8]) -> Option<Value<'a>> {
    let id = id(key)?;
    let (head, body) = value.split_at_checked(HEAD)?;
    if checksum(key, value).to_le_bytes() != head[..4] {
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
    Some(Value { info, tile, ledger })
}

/// The key is part of the sum: a sound value under another tile's key is damage too.
fn checksum(key: &[u8], value: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(key), &value[4..])
}

fn key(id: TileId) -> [u8; KEY] {
    let ordered = |value: i32| (value as u32 ^ 1 << 31).to_be_bytes();
    let mut key = [0; KEY];
    key[..2].copy_from_slice(&id.zone.epsg().to_be_bytes());
    key[2..6].copy_from_slice(&ordered(id.y));
    key[6..].copy_from_slice(&ordered(id.x));
    key
}

fn id(key: &[u8]) -> Option<TileId> {
    let key: &[u8; KEY] = key.try_into().ok()?;
    let [e0, e1, y0, y1, y2, y3, x0, x1, x2, x3] = *key;
    let unordered = |bytes: [u8; 4]| (u32::from_be_bytes(bytes) ^ 1 << 31) as i32;
    let zone = Zone::from_epsg(u32::from(u16::from_be_bytes([e0, e1]))).ok()?;
    Some(TileId { zone, y: unordered([y0, y1, y2, y3]), x: unordered([x0, x1, x2, x3]) })
}

fn damaged(id: TileId, reason: &dyn std::fmt::Display) -> Error {
    Error::Damaged { what: format!("tile {id}"), reason: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn keys_sort_as_ids_do(a: (i32, i32), b: (i32, i32), south: bool) {
            let zone = Zone::from_epsg(if south { 32714 } else { 32614 }).unwrap();
            let (a, b) = (TileId { zone, y: a.0, x: a.1 }, TileId { zone, y: b.0, x: b.1 });
            prop_assert_eq!(key(a).cmp(&key(b)), a.cmp(&b));
            prop_assert_eq!(id(&key(a)), Some(a));
        }

        #[test]
        fn a_changed_bit_of_a_value_is_noticed(at: prop::sample::Index, bit in 0..8_u8) {
            let dir = tempfile::tempdir().unwrap();
            let tiles = Tiles::open(dir.path(), 1 << 20).unwrap();
            let at_home = TileId { zone: Zone::from_epsg(32614).unwrap(), y: 2, x: -1 };
            tiles.put(at_home, &Folded { version: 3, ..Folded::default() }).unwrap();
            let (key, value) = tiles.value(at_home).unwrap().unwrap();
            let mut bad = value.to_vec();
            bad[at.index(value.len())] ^= 1_u8 << bit;
            tiles.tree.insert(key, bad).unwrap();
            prop_assert!(tiles.stored(at_home).is_err() && tiles.folded(at_home).is_err());
            prop_assert!(tiles.sound().unwrap().is_empty());
            prop_assert!(tiles.stored(at_home).unwrap().is_none());
        }
    }
}
