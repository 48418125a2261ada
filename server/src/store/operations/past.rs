//! A map of the past, as it was served.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use echofix_core::geo::{TileId, Zone};
use echofix_core::tile;
use tokio::sync::watch;
use uuid::Uuid;

use crate::store::api::{
    Error, InspectedTile, MapProgress, MapStatus, MapStore, Receipt, StoredTile, TileInfo, Totals,
    UploadRecord, Withheld,
};
use crate::store::map::catalog::Catalog;
use crate::store::map::context::StoreContext;
use crate::store::map::policy::Policy;
use crate::store::map::tiles::waiting;
use crate::store::map::write_buffer::Folded;
use crate::store::operations::history;

/// A map in memory that is only read, and changes no more.
struct PastMap {
    lineage: u64,
    tiles: BTreeMap<TileId, StoredTile>,
    /// All that is known of each tile, in bytes: few are inspected.
    evidence: BTreeMap<TileId, (Vec<u8>, Vec<u8>)>,
    policy: Policy,
    today: u16,
    catalog: Catalog,
    uploads: u64,
    progress: watch::Sender<MapProgress>,
}

pub(in crate::store) fn served_at(shared: &StoreContext, epoch: u64) -> Result<Arc<dyn MapStore>, Error> {
    history::in_journal(shared, epoch)?;
    let exclusion = shared.index.exclusion(epoch);
    let policy = &shared.settings.policy;
    let folded = history::folded(shared, epoch, &exclusion)?;
    let today = folded.values().map(|folded| folded.tile.newest_day()).max().unwrap_or_default();
    let (mut tiles, mut evidence, mut catalog) = (BTreeMap::new(), BTreeMap::new(), Catalog::default());
    for (id, folded) in folded {
        let newest_day = folded.tile.newest_day();
        let cells = folded.tile.supported(policy.publish_contributors).count() as u32;
        let mut info = TileInfo { id, version: folded.version, cells, newest_day, bytes: 0, waiting: 0 };
        info.waiting = waiting(&info, &folded.tile);
        evidence.insert(id, (tile::encode(&folded.tile), tile::encode_ledger(&folded.ledger)));
        let tile = policy.served(folded.tile, today);
        let stored = StoredTile { version: folded.version, day: today, tile: Arc::new(tile) };
        let bytes = stored.encoded().len() as u32;
        catalog.put(TileInfo { bytes, ..info });
        if cells > 0 {
            tiles.insert(id, stored);
        }
    }
    let compacted = shared.compacted_uploads.load(Ordering::Relaxed);
    let uploads = compacted + shared.index.uploads_within(0, epoch);
    let served = MapProgress { state: MapStatus::Serving, epoch, journaled: epoch, ..MapProgress::default() };
    let progress = watch::Sender::new(served);
    let (lineage, policy) = (shared.lineage, *policy);
    Ok(Arc::new(PastMap { lineage, tiles, evidence, policy, today, catalog, uploads, progress }))
}

impl MapStore for PastMap {
    fn contributor(&self, _: &str) -> u64 {
        // Nobody uploads to the past.
        0
    }

    fn lineage(&self) -> u64 {
        self.lineage
    }

    fn commit(&self, _: UploadRecord) -> Result<Receipt, Error> {
        Err(Error::Stopped("a map of the past takes no uploads".to_owned()))
    }

    fn counted(&self, _: Uuid) -> Result<Option<Receipt>, Error> {
        Ok(None)
    }

    fn tile(&self, id: TileId) -> Result<Option<StoredTile>, Error> {
        Ok(self.tiles.get(&id).cloned())
    }

    fn inspect(&self, id: TileId) -> Result<Option<InspectedTile>, Error> {
        let (Some((tile, ledger)), Some(info)) = (self.evidence.get(&id), self.catalog.get(id)) else {
            return Ok(None);
        };
        let damaged = |error: tile::DecodeError| Error::Damaged {
            what: format!("tile {id}"),
            reason: error.to_string(),
        };
        let tile = tile::decode(tile).map_err(damaged)?;
        let ledger = tile::decode_ledger(ledger).map_err(damaged)?;
        let folded = Folded { version: info.version, tile, ledger };
        Ok(Some(self.policy.inspected(folded, self.today)))
    }

    fn catalog(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Vec<TileInfo>, Error> {
        let mut found = self.catalog.block(zone, &x, &y);
        found.retain(|info| info.cells > 0);
        Ok(found)
    }

    fn withheld(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Option<Withheld>, Error> {
        Ok(self.catalog.withheld((zone, &x, &y), self.policy.publish_contributors))
    }

    fn zones(&self) -> Vec<Zone> {
        self.catalog.zones()
    }

    fn totals(&self) -> Totals {
        self.catalog.totals(self.uploads, self.policy.publish_contributors)
    }

    fn progress(&self) -> watch::Receiver<MapProgress> {
        self.progress.subscribe()
    }
}
