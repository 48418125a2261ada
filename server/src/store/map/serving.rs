//! Folding into the generation that is served: who prepares for what will be read does so before it is.

use std::collections::BTreeMap;
use std::sync::Arc;

use echofix_core::geo::TileId;
use echofix_core::tile::Tile;

use super::context::StoreContext;
use super::fold::Sink;
use super::generation::Generation;
use super::tiles::TileValue;
use super::write_buffer::{Folded, Source};
use crate::store::api::{Error, QuarantinedRecord, TileInfo, UpcomingMap};

/// The generation that is served, to be folded into.
pub(super) struct Serving<'a> {
    pub(super) shared: &'a StoreContext,
    pub(super) on: &'a Generation,
}

impl Source for Serving<'_> {
    fn folded(&self, id: TileId) -> Result<Folded, Error> {
        self.on.tiles.folded(id)
    }
}

impl Sink for Serving<'_> {
    fn write(
        &mut self,
        changed: impl Iterator<Item = (TileId, Folded)>,
        quarantined: &[QuarantinedRecord],
        folded: u64,
    ) -> Result<(), Error> {
        let publish = self.shared.settings.policy.publish_contributors;
        let (mut values, mut tiles) = (Vec::new(), BTreeMap::new());
        for (id, folded) in changed {
            let value = TileValue::new(id, &folded, publish);
            tiles.insert(id, (value.info, folded.tile));
            values.push(value);
        }
        prepare(self.shared, self.on, tiles);
        self.on.put_values(values, quarantined, folded)
    }
}

/// Lets who wants to prepare for a generation that will be served, with these tiles in place of those it has.
pub(super) fn prepare(shared: &StoreContext, on: &Generation, changed: BTreeMap<TileId, (TileInfo, Tile)>) {
    let Some(prepare) = shared.preparing() else { return };
    let day = changed.values().map(|(info, _)| info.newest_day).fold(on.catalog().newest_day(), u16::max);
    prepare(&Upcoming { shared, on, changed, day });
}

/// A generation, with changed tiles that it does not have yet.
struct Upcoming<'a> {
    shared: &'a StoreContext,
    on: &'a Generation,
    changed: BTreeMap<TileId, (TileInfo, Tile)>,
    day: u16,
}

impl UpcomingMap for Upcoming<'_> {
    fn newest_day(&self) -> u16 {
        self.day
    }

    fn version(&self, id: TileId) -> u64 {
        let changed = self.changed.get(&id).map(|(info, _)| *info);
        let info = changed.or_else(|| self.on.catalog().get(id).copied());
        info.filter(|info| info.cells > 0).map_or(0, |info| info.version)
    }

    fn tile(&self, id: TileId) -> Result<Option<Arc<Tile>>, Error> {
        if self.version(id) == 0 {
            return Ok(None);
        }
        let tile = match self.changed.get(&id) {
            Some((_, tile)) => Some(tile.clone()),
            None => self.on.tiles.stored(id)?.map(|(_, tile)| tile),
        };
        Ok(tile.map(|tile| self.shared.settings.policy.served(tile, self.day).into()))
    }

    fn goes_on(&self) -> bool {
        !self.shared.index.ended()
    }
}
