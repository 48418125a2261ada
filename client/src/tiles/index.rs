//! Which tiles a cache has, and in which order they were used.

use std::collections::BTreeMap;

use echofix_core::geo::TileId;

use super::name::{Form, TileVersionName};

/// The tiles of a cache. Times are counts of uses.
#[derive(Debug, Default)]
pub(super) struct CacheIndex {
    tiles: BTreeMap<TileId, CachedTile>,
    by_use: BTreeMap<u64, TileId>,
    bytes: u64,
    now: u64,
}

#[derive(Debug, Clone, Copy)]
struct CachedTile {
    version: u64,
    form: Form,
    bytes: u64,
    used: u64,
}

impl CachedTile {
    fn name(&self, id: TileId) -> TileVersionName {
        TileVersionName { id, version: self.version, form: self.form }
    }
}

impl CacheIndex {
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Bytes with another tile, which replaces its other version.
    pub(super) fn bytes_with(&self, newcomer: Option<(TileId, u64)>) -> u64 {
        newcomer.map_or(self.bytes, |(id, bytes)| {
            self.bytes + bytes - self.tiles.get(&id).map_or(0, |entry| entry.bytes)
        })
    }

    pub(super) fn version(&self, id: TileId) -> Option<u64> {
        Some(self.tiles.get(&id)?.version)
    }

    pub(super) fn versions(&self) -> impl Iterator<Item = (TileId, u64)> {
        self.tiles.iter().map(|(id, entry)| (*id, entry.version))
    }

    pub(super) fn name(&self, id: TileId) -> Option<TileVersionName> {
        self.tiles.get(&id).map(|entry| entry.name(id))
    }

    pub(super) fn names(&self) -> impl Iterator<Item = TileVersionName> {
        self.tiles.iter().map(|(id, entry)| entry.name(*id))
    }

    /// A time that all uses before are older than.
    pub(super) fn tick(&mut self) -> u64 {
        self.now += 1;
        self.now
    }

    /// Notes a use; returns the tile's version and form.
    pub(super) fn touch(&mut self, id: TileId) -> Option<TileVersionName> {
        let now = self.tick();
        let entry = self.tiles.get_mut(&id)?;
        self.by_use.remove(&entry.used);
        self.by_use.insert(now, id);
        entry.used = now;
        Some(entry.name(id))
    }

    /// Takes a tile, used now; it replaces another version of it.
    pub(super) fn insert(&mut self, name: TileVersionName, bytes: u64) {
        let TileVersionName { id, version, form } = name;
        let used = self.tick();
        if let Some(before) = self.tiles.insert(id, CachedTile { version, form, bytes, used }) {
            self.by_use.remove(&before.used);
            self.bytes -= before.bytes;
        }
        self.by_use.insert(used, id);
        self.bytes += bytes;
    }

    /// Forgets a tile if it is this version that is there.
    pub(super) fn forget(&mut self, name: TileVersionName) {
        if self.name(name.id) == Some(name)
            && let Some(entry) = self.tiles.remove(&name.id)
        {
            self.by_use.remove(&entry.used);
            self.bytes -= entry.bytes;
        }
    }

    /// The tile that was not used for longest, nor at `since` or later.
    pub(super) fn oldest(&self, since: u64) -> Option<TileVersionName> {
        let (used, id) = self.by_use.first_key_value()?;
        if *used < since { self.name(*id) } else { None }
    }
}
