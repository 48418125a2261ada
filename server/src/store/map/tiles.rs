//! Tiles in a table, which is not trusted: every tile carries its own checksum, and with every change goes,
//! in one batch, how far the journal is folded and a digest of all tiles' versions. Tiles that it lost, or
//! has from another time, are noticed by it; then all are folded again.
//!
//! ```text
//! key    see [`crate::store::map::key`]
//! value  in pieces, see [`crate::store::map::pieces`]: CRC-32C of key and the rest (4) | version (8) | cells served (4) | newest day (2) | tile length (4) | tile | ledger
//! a quarantined upload: see [`crate::store::map::quarantine`]
//! state  CRC-32C of the rest (4) | number of the last record folded (8) | digest (8)
//! ```

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockWriteGuard};

use echofix_core::geo::TileId;
use echofix_core::tile::{self, Tile};

use super::attempt::TilesError;
use super::catalog::Catalog;
use super::key::key;
use super::write_buffer::{Folded, Source};
use super::{pieces, quarantine};
use crate::store::api::QuarantinedRecord;
use crate::store::api::{Error, TileInfo};
use crate::store::backend::tables::{Batch, TileTable};
use crate::store::checksum::{SUM, seal, sealed};

/// Where it says how far the tiles are folded.
const STATE: &[u8] = b"state";
/// Bytes of a value between its checksum and the tile.
const HEAD: usize = 18;

/// The tile store. Once its table failed nothing more is written, and what is read is as it was before.
pub(in crate::store) struct TileStore {
    table: Box<dyn TileTable>,
    /// Values as they were before a write, until all of it is durable; `None` for what was not there. After a write that
    /// failed, of which the table may hold any part, they stay.
    before: RwLock<HashMap<TileId, Option<Vec<u8>>>>,
    /// Held by who changes tiles, and by who must see them all of one time.
    changing: Mutex<()>,
}

impl TileStore {
    pub(in crate::store) fn of(table: Box<dyn TileTable>) -> Self {
        Self { table, before: RwLock::default(), changing: Mutex::default() }
    }

    pub(in crate::store) fn table(&self) -> &dyn TileTable {
        &*self.table
    }

    /// All tiles and how far they are folded; `Err` says what is wrong with them. Nothing is folded meanwhile.
    pub(in crate::store) fn check(&self) -> Result<(Catalog, u64), TilesError> {
        let _unchanged = self.changing();
        let mut catalog = Catalog::default();
        let mut from = Vec::new();
        while let Some(entry) = self.table.scan(&from).next() {
            let (key, _) = entry?;
            from = if let Some(id) = pieces::tile_of(&key) {
                let value = self.value(id)?.unwrap_or_default();
                catalog.put(parse(id, &value)?.described()?);
                after(&pieces::last_key(id))
            } else if key == STATE || quarantine::is_key(&key) {
                after(&key)
            } else {
                return Err(TilesError::UnknownKey(key));
            };
        }
        match self.table.get(STATE)? {
            None => Err(TilesError::NoState),
            Some(state) => match parse_state(&state) {
                Some((folded, digest)) if digest == catalog.digest() => Ok((catalog, folded)),
                Some(_) => Err(TilesError::Incomplete),
                None => Err(TilesError::StateDamaged),
            },
        }
    }

    /// Version and evidence of a tile.
    pub(in crate::store) fn stored(&self, id: TileId) -> Result<Option<(u64, Tile)>, Error> {
        let Some(value) = self.value(id)? else { return Ok(None) };
        let value = parse(id, &value)?;
        let tile = tile::decode(value.tile).map_err(|e| damaged(id, &e))?;
        Ok(Some((value.info.version, tile)))
    }

    /// Version and encoded bytes of a tile.
    pub(in crate::store) fn raw(&self, id: TileId) -> Result<Option<(u64, Vec<u8>)>, Error> {
        let Some(value) = self.value(id)? else { return Ok(None) };
        let value = parse(id, &value)?;
        Ok(Some((value.info.version, value.tile.to_vec())))
    }

    /// Puts tiles, the uploads that were quarantined, and how far the tiles go, all or none, and brings them to disk.
    /// After a failure the store is [broken](Self::broken), and shows what it showed before.
    pub(in crate::store) fn put_all(
        &self,
        values: Vec<TileValue>,
        quarantined: &[QuarantinedRecord],
        folded: u64,
        digest: u64,
    ) -> Result<(), Error> {
        let _changing = self.changing();
        if let Some(reason) = self.broken() {
            return Err(Error::Broken(reason));
        }
        let mut batch = Batch::default();
        let mut before = HashMap::with_capacity(values.len());
        for TileValue { bytes, info } in values {
            before.insert(info.id, self.value(info.id)?);
            pieces::put(self.table(), &mut batch, info.id, &bytes)?;
        }
        for quarantined in quarantined {
            batch.put(&quarantine::key(quarantined.number), &quarantine::encode(quarantined));
        }
        batch.put(STATE, &state(folded, digest));
        // Shown until all is durable: nobody sees half of a tile's pieces, or what a failure takes back.
        *self.before_mut() = before;
        self.table.apply(batch)?;
        self.before_mut().clear();
        Ok(())
    }

    /// Why nothing is written any more; `None` while all is well.
    pub(in crate::store) fn broken(&self) -> Option<String> {
        self.table.broken()
    }

    /// The values of all tiles, as they are to be read, for a copy.
    pub(in crate::store) fn copied(&self, id: TileId) -> Result<Option<TileValue>, Error> {
        let Some(bytes) = self.value(id)? else { return Ok(None) };
        let info = parse(id, &bytes)?.described()?;
        Ok(Some(TileValue { bytes, info }))
    }

    /// The quarantined uploads, oldest first.
    pub(in crate::store) fn quarantined(&self) -> Result<Vec<QuarantinedRecord>, Error> {
        let damaged = || Error::Damaged {
            what: "a note of a quarantined upload".to_owned(),
            reason: "its checksum does not match".to_owned(),
        };
        let mut notes = Vec::new();
        for entry in self.table.scan(quarantine::PREFIX) {
            let (key, value) = entry?;
            if !quarantine::is_key(&key) {
                break;
            }
            notes.push(quarantine::decode(&key, &value).ok_or_else(damaged)?);
        }
        Ok(notes)
    }

    fn value(&self, id: TileId) -> Result<Option<Vec<u8>>, Error> {
        // Held while the pieces are read: no write begins meanwhile.
        let shown = self.before.read().unwrap_or_else(PoisonError::into_inner);
        match shown.get(&id) {
            Some(before) => Ok(before.clone()),
            None => pieces::get(self.table(), id),
        }
    }

    fn before_mut(&self) -> RwLockWriteGuard<'_, HashMap<TileId, Option<Vec<u8>>>> {
        self.before.write().unwrap_or_else(PoisonError::into_inner)
    }

    fn changing(&self) -> MutexGuard<'_, ()> {
        self.changing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The first key that may come after one.
fn after(key: &[u8]) -> Vec<u8> {
    [key, &[0]].concat()
}

impl Source for TileStore {
    fn folded(&self, id: TileId) -> Result<Folded, Error> {
        let Some(value) = self.value(id)? else { return Ok(Folded::default()) };
        let value = parse(id, &value)?;
        let tile = tile::decode(value.tile).map_err(|e| damaged(id, &e))?;
        let ledger = tile::decode_ledger(value.ledger).map_err(|e| damaged(id, &e))?;
        Ok(Folded { version: value.info.version, tile, ledger })
    }
}

/// A tile in the bytes it is stored in.
pub(in crate::store) struct TileValue {
    bytes: Vec<u8>,
    pub(in crate::store) info: TileInfo,
}

impl TileValue {
    /// Bytes that are stored.
    pub(in crate::store) fn len(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Of its cells those count that are served when `publish` contributors are asked for.
    pub(in crate::store) fn new(id: TileId, folded: &Folded, publish: u8) -> Self {
        let encoded = tile::encode(&folded.tile);
        let info = TileInfo {
            id,
            version: folded.version,
            cells: folded.tile.supported(publish).count() as u32,
            newest_day: folded.tile.newest_day(),
            bytes: encoded.len() as u32,
            waiting: 0,
        };
        let info = TileInfo { waiting: waiting(&info, &folded.tile), ..info };
        let mut bytes = vec![0; SUM];
        bytes.extend_from_slice(&info.version.to_le_bytes());
        bytes.extend_from_slice(&info.cells.to_le_bytes());
        bytes.extend_from_slice(&info.newest_day.to_le_bytes());
        bytes.extend_from_slice(&info.bytes.to_le_bytes());
        bytes.extend_from_slice(&encoded);
        bytes.extend_from_slice(&tile::encode_ledger(&folded.ledger));
        seal(&mut bytes, &key(id));
        Self { bytes, info }
    }
}

fn state(folded: u64, digest: u64) -> Vec<u8> {
    let mut bytes = vec![0; SUM];
    bytes.extend_from_slice(&folded.to_le_bytes());
    bytes.extend_from_slice(&digest.to_le_bytes());
    seal(&mut bytes, STATE);
    bytes
}

fn parse_state(bytes: &[u8]) -> Option<(u64, u64)> {
    let rest: &[u8; 16] = sealed(bytes, STATE)?.try_into().ok()?;
    let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| rest[at + i]));
    Some((word(0), word(8)))
}

/// A value whose checksum matches.
struct Parsed<'a> {
    info: TileInfo,
    tile: &'a [u8],
    ledger: &'a [u8],
}

impl Parsed<'_> {
    /// What the catalog says about it: what waits is not stored, but follows from the tile.
    fn described(&self) -> Result<TileInfo, Error> {
        let info = self.info;
        if info.cells > 0 {
            return Ok(info);
        }
        let tile = tile::decode(self.tile).map_err(|e| damaged(info.id, &e))?;
        Ok(TileInfo { waiting: waiting(&info, &tile), ..info })
    }
}

/// See [`TileInfo::waiting`].
pub(in crate::store) fn waiting(info: &TileInfo, tile: &Tile) -> u8 {
    let most = || tile.support().iter().copied().max().unwrap_or(0);
    if info.cells > 0 || tile.is_empty() { 0 } else { most().max(1) }
}

fn parse(id: TileId, value: &[u8]) -> Result<Parsed<'_>, Error> {
    parse_sound(id, value).ok_or_else(|| damaged(id, &"its checksum does not match"))
}

fn parse_sound(id: TileId, value: &[u8]) -> Option<Parsed<'_>> {
    let (head, body) = sealed(value, &key(id))?.split_at_checked(HEAD)?;
    let info = TileInfo {
        id,
        version: u64::from_le_bytes(head[..8].try_into().ok()?),
        cells: u32::from_le_bytes(head[8..12].try_into().ok()?),
        newest_day: u16::from_le_bytes(head[12..14].try_into().ok()?),
        bytes: u32::from_le_bytes(head[14..18].try_into().ok()?),
        waiting: 0,
    };
    let (tile, ledger) = body.split_at_checked(info.bytes as usize)?;
    Some(Parsed { info, tile, ledger })
}

fn damaged(id: TileId, reason: &dyn std::fmt::Display) -> Error {
    Error::Damaged { what: format!("tile {id}"), reason: reason.to_string() }
}

#[cfg(test)]
mod tests;
