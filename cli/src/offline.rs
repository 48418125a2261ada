//! Localizing without a service: the same matcher on the tiles that this machine has.

use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use echofix_client::refusal::CallError;
use echofix_client::tiles::{TileCache, TileCacheLimits};
use echofix_client::vehicle::LocalizationQuestion;
use echofix_core::geo::{TileId, Zone};
use echofix_core::point::MapPoint;
use echofix_harness::replay::Answering;
use echofix_proto::v1::LocalizeResponse;
use echofix_server::args::ServeArgs;
use echofix_server::grpc::LocalizationApi;
use echofix_server::locating::Locator;
use echofix_server::store::{
    Error, MapProgress, MapStatus, MapStore, Receipt, StoredTile, TileInfo, Totals, UploadRecord, Withheld,
};
use tokio::sync::watch;

/// A map of cached tiles, which is only read.
struct CachedMap {
    cache: TileCache,
    /// In order of their ids.
    infos: Vec<TileInfo>,
    progress: watch::Sender<MapProgress>,
}

impl CachedMap {
    /// Reads every tile once, since a cache knows no more of them than their versions.
    fn of(cache: TileCache) -> anyhow::Result<Self> {
        let mut infos = Vec::new();
        for (id, _) in cache.versions() {
            let Some((version, tile)) = cache.tile(id)? else { continue };
            let (cells, newest_day) = (tile.len() as u32, tile.newest_day());
            infos.push(TileInfo { id, version, cells, newest_day, bytes: 0, waiting: 0 });
        }
        infos.sort_unstable_by_key(|info| info.id);
        // Versions on the wire are no epochs; what is cached is one state of the map.
        let progress = MapProgress { state: MapStatus::Serving, ..MapProgress::default() };
        Ok(Self { cache, infos, progress: watch::Sender::new(progress) })
    }
}

impl MapStore for CachedMap {
    fn contributor(&self, _: &str) -> u64 {
        0
    }

    fn lineage(&self) -> u64 {
        0
    }

    fn commit(&self, _: UploadRecord) -> Result<Receipt, Error> {
        Err(Error::Unusable("a cache takes no uploads".to_owned()))
    }

    fn counted(&self, _: uuid::Uuid) -> Result<Option<Receipt>, Error> {
        Ok(None)
    }

    fn tile(&self, id: TileId) -> Result<Option<StoredTile>, Error> {
        let damaged = |error: echofix_client::tiles::Error| Error::Damaged {
            what: format!("tile {id} of the cache"),
            reason: error.to_string(),
        };
        let tile = self.cache.tile(id).map_err(damaged)?;
        Ok(tile.map(|(version, tile)| StoredTile { version, day: 0, tile: Arc::new(tile) }))
    }

    fn catalog(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Vec<TileInfo>, Error> {
        let inside = |info: &&TileInfo| {
            info.id.zone == zone && info.cells > 0 && x.contains(&info.id.x) && y.contains(&info.id.y)
        };
        Ok(self.infos.iter().filter(inside).copied().collect())
    }

    fn withheld(
        &self,
        _: Zone,
        _: RangeInclusive<i32>,
        _: RangeInclusive<i32>,
    ) -> Result<Option<Withheld>, Error> {
        // What a service withholds it does not send.
        Ok(None)
    }

    fn zones(&self) -> Vec<Zone> {
        let mut zones: Vec<_> = self.infos.iter().map(|info| info.id.zone).collect();
        zones.dedup();
        zones
    }

    fn totals(&self) -> Totals {
        Totals { tiles: self.infos.len() as u64, ..Totals::default() }
    }

    fn progress(&self) -> watch::Receiver<MapProgress> {
        self.progress.subscribe()
    }
}

/// Answers from cached tiles as a service with the same settings would.
#[derive(Clone)]
pub struct OfflineLocalizer(Arc<Inner>);

struct Inner {
    map: Arc<CachedMap>,
    locator: Arc<Locator>,
    api: LocalizationApi,
}

impl OfflineLocalizer {
    /// Opens the tiles in a folder, as `echofix tiles sync` leaves them.
    ///
    /// # Errors
    /// When there are none, or they cannot be read.
    pub fn open(folder: &Path) -> anyhow::Result<Self> {
        let told = || format!("reading the tiles in {}", folder.display());
        anyhow::ensure!(folder.is_dir(), "{} is no folder; `echofix tiles sync` makes one", folder.display());
        let cache = TileCache::open(folder, TileCacheLimits { max_bytes: u64::MAX }).with_context(told)?;
        let map = CachedMap::of(cache).with_context(told)?;
        anyhow::ensure!(
            !map.infos.is_empty(),
            "there are no tiles in {}; fetch some with `echofix tiles sync`",
            folder.display()
        );
        let config = ServeArgs::default().config()?;
        let map = Arc::new(map);
        let locator = Arc::new(Locator::new(Arc::<CachedMap>::clone(&map), config.locating));
        let api = LocalizationApi::new(Arc::clone(&locator), Arc::default(), Arc::default());
        Ok(Self(Arc::new(Inner { map, locator, api })))
    }

    /// Centres of the occupied cells within a square around a point, half of whose side is given.
    ///
    /// # Errors
    /// When a tile cannot be read.
    pub fn cells(&self, zone: Zone, centre: MapPoint, half_m: f64) -> anyhow::Result<Vec<MapPoint>> {
        let mut cells = Vec::new();
        for id in TileId::covering(zone, centre, half_m) {
            let Some(stored) = self.0.map.tile(id)? else { continue };
            cells.extend(stored.tile.cells().iter().map(|(index, _)| id.cell(*index).centre()));
        }
        cells.retain(|cell| {
            (cell.x_m - centre.x_m).abs() <= half_m && (cell.y_m - centre.y_m).abs() <= half_m
        });
        Ok(cells)
    }
}

impl Answering for OfflineLocalizer {
    async fn answer(&self, question: &LocalizationQuestion) -> Result<LocalizeResponse, CallError> {
        let admitted = self.0.locator.admit().await;
        let admitted = admitted
            .map_err(|refusal| CallError::Overloaded { message: refusal.to_string(), retry_after: None })?;
        let (inner, request) = (Arc::clone(&self.0), question.request.clone());
        let work = tokio::task::spawn_blocking(move || inner.api.work(request, admitted));
        let done = work.await.map_err(|error| CallError::Unavailable {
            message: format!("the alignment broke down: {error}"),
            retry_after: None,
        })?;
        done.map_err(|status| CallError::from(&status))
    }
}
