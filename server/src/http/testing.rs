//! A small map and a site that serves it, for the tests of this module.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::{Cursor, Read, Write};
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::{Method, Request};
use axum::response::Response;
use bytes::Bytes;
use echofix_core::align::Search;
use echofix_core::align::verdict::Integrity;
use echofix_core::evidence::{Cell, CellHits, EvidenceDelta, Pass, TileEvidence, presence};
use echofix_core::geo::{TileId, Zone};
use echofix_core::tile::Tile;
use echofix_core::vetting::alarm::AlarmLimits;
use tempfile::TempDir;
use tokio::sync::watch;
use tower::ServiceExt;
use uuid::Uuid;

use super::{BaseMap, HttpState, Place, router, router_at};
use crate::feed::{FixEvent, UploadEvent};
use crate::identity::{Gate, IdentityConfig, Rates, RatesConfig, TlsConfig};
use crate::locating::Expectations;
use crate::store::testing::some_uploads;
use crate::store::{
    ContributedUpload, ContributorFigures, EmbeddedStore, Error, HistoryEvent, Imported, MapProgress,
    MapStatus, MapStore, Operations, Options, Policy, Preview, Proposal, QuarantinedRecord, Receipt, Region,
    Remark, Snapshot, StoredTile, TileInfo, Totals, UploadRecord, Verified, Withheld,
};

/// 2024-10-04
pub const DAY: u16 = 20_000;

/// A tile in the middle of Austin.
pub fn austin() -> TileId {
    TileId { zone: Zone::from_epsg(32614).unwrap(), x: 12_127, y: 65_410 }
}

fn serving(epoch: u64) -> MapProgress {
    MapProgress { state: MapStatus::Serving, epoch, journaled: epoch, ..MapProgress::default() }
}

/// A map in memory that is only read.
pub struct FakeStore {
    tiles: Mutex<BTreeMap<TileId, StoredTile>>,
    /// Tiles asked for.
    pub reads: AtomicUsize,
    /// The map's lineage.
    pub lineage: AtomicU64,
    progress: watch::Sender<MapProgress>,
    /// What vetting kept out of it.
    pub kept_out: Mutex<Vec<QuarantinedRecord>>,
    folds: Mutex<Option<Arc<Folds>>>,
}

/// Folds of past maps, which wait until they are let go.
#[derive(Default)]
pub struct Folds {
    now: AtomicUsize,
    pub most_at_once: AtomicUsize,
    pub all: AtomicUsize,
    released: (Mutex<bool>, Condvar),
}

impl Folds {
    fn one(&self) {
        self.all.fetch_add(1, Ordering::SeqCst);
        self.most_at_once.fetch_max(self.now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
        let (released, changed) = &self.released;
        drop(changed.wait_while(released.lock().unwrap(), |released| !*released).unwrap());
        self.now.fetch_sub(1, Ordering::SeqCst);
    }

    /// Until so many have begun.
    pub async fn begun(&self, count: usize) {
        while self.all.load(Ordering::SeqCst) < count {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Lets all go on, from now on at once.
    pub fn release(&self) {
        *self.released.0.lock().unwrap() = true;
        self.released.1.notify_all();
    }
}

impl Default for FakeStore {
    fn default() -> Self {
        Self {
            tiles: Mutex::default(),
            reads: AtomicUsize::new(0),
            lineage: AtomicU64::new(0),
            progress: watch::Sender::new(serving(1)),
            kept_out: Mutex::default(),
            folds: Mutex::default(),
        }
    }
}

impl FakeStore {
    /// A map of these tiles, each with cells given as (index, passes).
    pub fn with_tiles(tiles: &[(TileId, &[(u32, u32)])]) -> Self {
        let store = Self::default();
        for (id, cells) in tiles {
            let cell = |passes: u32| Cell {
                hits: 2 * passes,
                passes,
                contributors: passes.min(255) as u8,
                presence: presence::ALWAYS,
                first_day: DAY,
                last_day: DAY,
                offset_sum: [0; 2],
            };
            let cells = cells.iter().map(|(index, passes)| (*index, cell(*passes))).collect();
            store.put(*id, Tile::from_cells(cells).unwrap());
        }
        store
    }

    pub fn put(&self, id: TileId, tile: Tile) {
        let stored = StoredTile { version: 1, day: 0, tile: Arc::new(tile) };
        self.tiles.lock().unwrap().insert(id, stored);
    }

    /// There are past maps from now on, whose folds wait until they are let go.
    pub fn hold_folds(&self) -> Arc<Folds> {
        Arc::clone(self.folds.lock().unwrap().insert(Arc::default()))
    }

    /// A tile changes.
    pub fn touch(&self, id: TileId) {
        let epoch = self.progress.borrow().epoch + 1;
        self.tiles.lock().unwrap().get_mut(&id).unwrap().version = epoch;
        self.publish_epoch(epoch);
    }

    /// The map moves on.
    pub fn publish_epoch(&self, epoch: u64) {
        self.progress.send_replace(serving(epoch));
    }

    /// The map is being folded anew.
    pub fn rebuild(&self) {
        self.progress.send_modify(|progress| progress.state = MapStatus::Rebuilding);
    }

    fn infos(&self) -> Vec<TileInfo> {
        let tiles = self.tiles.lock().unwrap();
        let info = |(id, stored): (&TileId, &StoredTile)| TileInfo {
            id: *id,
            version: stored.version,
            cells: stored.tile.len() as u32,
            newest_day: stored.tile.newest_day(),
            bytes: stored.encoded().len() as u32,
            waiting: 0,
        };
        tiles.iter().map(info).collect()
    }
}

impl MapStore for FakeStore {
    fn contributor(&self, pseudonym: &str) -> u64 {
        pseudonym.len() as u64
    }

    fn lineage(&self) -> u64 {
        self.lineage.load(Ordering::Relaxed)
    }

    fn commit(&self, _: UploadRecord) -> Result<Receipt, Error> {
        Err(only_read())
    }

    fn counted(&self, _: Uuid) -> Result<Option<Receipt>, Error> {
        Ok(None)
    }

    fn tile(&self, id: TileId) -> Result<Option<StoredTile>, Error> {
        self.reads.fetch_add(1, Ordering::Relaxed);
        let day = self.totals().newest_day;
        let stored = self.tiles.lock().unwrap().get(&id).cloned();
        Ok(stored.map(|stored| StoredTile { day, ..stored }))
    }

    fn catalog(
        &self,
        zone: Zone,
        x: RangeInclusive<i32>,
        y: RangeInclusive<i32>,
    ) -> Result<Vec<TileInfo>, Error> {
        let MapProgress { state, epoch, journaled, .. } = *self.progress.borrow();
        if state == MapStatus::Rebuilding {
            return Err(Error::Rebuilding { folded: epoch, journaled });
        }
        let inside = |t: &TileInfo| t.id.zone == zone && x.contains(&t.id.x) && y.contains(&t.id.y);
        Ok(self.infos().into_iter().filter(inside).collect())
    }

    fn withheld(
        &self,
        _: Zone,
        _: RangeInclusive<i32>,
        _: RangeInclusive<i32>,
    ) -> Result<Option<Withheld>, Error> {
        Ok(None)
    }

    fn zones(&self) -> Vec<Zone> {
        let mut zones: Vec<_> = self.infos().iter().map(|t| t.id.zone).collect();
        zones.dedup();
        zones
    }

    fn totals(&self) -> Totals {
        let infos = self.infos();
        Totals {
            tiles: infos.len() as u64,
            cells: infos.iter().map(|t| u64::from(t.cells)).sum(),
            bytes: infos.iter().map(|t| u64::from(t.bytes)).sum(),
            uploads: 3,
            newest_day: infos.iter().map(|t| t.newest_day).max().unwrap_or(0),
            ..Totals::default()
        }
    }

    fn progress(&self) -> watch::Receiver<MapProgress> {
        self.progress.subscribe()
    }
}

impl Operations for FakeStore {
    fn wind_down(&self) {}

    fn kept_out(&self) -> tokio::sync::broadcast::Receiver<QuarantinedRecord> {
        tokio::sync::broadcast::Sender::new(1).subscribe()
    }

    fn quarantined(&self) -> Result<Vec<QuarantinedRecord>, Error> {
        Ok(self.kept_out.lock().unwrap().clone())
    }

    fn decide(&self, _: &Proposal, _: &Remark) -> Result<Option<u64>, Error> {
        Err(only_read())
    }

    fn preview(&self, _: &Proposal) -> Result<Preview, Error> {
        Err(only_read())
    }

    fn upload_ids(&self, _: &BTreeSet<u64>) -> HashMap<u64, Uuid> {
        HashMap::new()
    }

    fn contributors(&self) -> Result<Vec<ContributorFigures>, Error> {
        Err(only_read())
    }

    fn uploads_of(&self, _: u64, _: u64, _: usize) -> Result<Vec<ContributedUpload>, Error> {
        Err(only_read())
    }

    fn upload(&self, _: Uuid) -> Result<Option<(u64, ContributedUpload)>, Error> {
        Err(only_read())
    }

    fn epochs(&self) -> (u64, u64) {
        (0, self.progress.borrow().epoch)
    }

    fn served_at(&self, _: u64) -> Result<Arc<dyn MapStore>, Error> {
        let folds = self.folds.lock().unwrap().clone();
        folds.ok_or_else(only_read)?.one();
        Ok(Arc::new(Self::default()))
    }

    fn history(&self, _: usize) -> Vec<HistoryEvent> {
        Vec::new()
    }

    fn at(&self, _: u64) -> Result<Snapshot, Error> {
        Err(only_read())
    }

    fn export(&self, _: &Region, _: &mut dyn Write) -> Result<u64, Error> {
        Err(only_read())
    }

    fn import(&self, _: &mut dyn Read) -> Result<Imported, Error> {
        Err(only_read())
    }

    fn backup(&self, _: &mut dyn Write) -> Result<u64, Error> {
        Err(only_read())
    }

    fn verify(&self, _: bool) -> Result<Verified, Error> {
        Err(only_read())
    }
}

fn only_read() -> Error {
    Error::Stopped("this map is only read".to_owned())
}

/// The routes over a small map.
pub struct TestSite {
    pub store: Arc<FakeStore>,
    pub state: HttpState,
    /// Turns true when the service drains.
    pub ending: watch::Sender<bool>,
    router: Router,
}

impl Default for TestSite {
    fn default() -> Self {
        Self::with_tiles(&[])
    }
}

impl TestSite {
    pub fn with_tiles(tiles: &[(TileId, &[(u32, u32)])]) -> Self {
        let store = Arc::new(FakeStore::with_tiles(tiles));
        let ending = watch::Sender::new(false);
        let known = Arc::clone(&store) as Arc<dyn MapStore>;
        let state = HttpState {
            expectations: Arc::new(Expectations::new(
                Arc::clone(&known),
                Search::default(),
                Integrity::default(),
            )),
            store: known,
            operations: Arc::clone(&store) as Arc<dyn Operations>,
            alarm_limits: AlarmLimits::default(),
            feed: Arc::default(),
            metrics: Arc::default(),
            health: Arc::default(),
            spool_dir: std::env::temp_dir(),
            address_share: 1.0,
            ending: ending.subscribe(),
        };
        Self { store, state: state.clone(), ending, router: router(state) }
    }

    /// The same with a map of streets.
    pub fn with_base_map(self, base_map: Option<BaseMap>) -> Self {
        let place = Place { base_map, ..Place::any() };
        let router = router_at(
            self.state.clone(),
            place,
            (Arc::new(Gate::open()), Arc::new(Rates::of(&RatesConfig::default()))),
        );
        Self { router, ..self }
    }

    pub async fn get(&self, path: &str) -> Response {
        self.send(Method::GET, path, &[]).await
    }

    pub async fn send(&self, method: Method, path: &str, headers: &[(&str, &str)]) -> Response {
        let request = Request::builder().method(method).uri(path);
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        self.router.clone().oneshot(request.body(Body::empty()).unwrap()).await.unwrap()
    }
}

/// Uploads, each of a contributor that hits these cells of the tile in Austin; the contributor's number is its day, too.
pub fn uploads_of(hits: &[(u64, &[u32])]) -> Vec<UploadRecord> {
    let upload = |(usual, (contributor, cells)): (UploadRecord, &(u64, &[u32]))| {
        let hit = |index: &u32| CellHits { index: *index, hits: 2, offset_sum: [256; 2] };
        let evidence = TileEvidence::of_hits(cells.iter().map(hit).collect());
        let detections = evidence.detections();
        let contribution = EvidenceDelta { tiles: [(austin(), evidence)].into(), detections };
        let pass = Pass { day: DAY + *contributor as u16, contributor: *contributor };
        UploadRecord { pass, contribution, ..usual }
    };
    some_uploads(hits.len()).into_iter().zip(hits).map(upload).collect()
}

/// The routes over a store on disk.
pub struct StoredSite {
    store: Arc<EmbeddedStore>,
    pub uploads: Vec<UploadRecord>,
    router: Router,
    _dir: TempDir,
}

impl StoredSite {
    /// A store that was given so many uploads and shows them.
    pub async fn with_uploads(count: usize) -> Self {
        Self::of(some_uploads(count), Policy::trusting(), Gate::open()).await
    }

    /// A store that was given these uploads under a policy and shows them to whom the gate lets in.
    pub async fn of(uploads: Vec<UploadRecord>, policy: Policy, gate: Gate) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let data_dir = dir.path().to_owned();
        let usual = Options::new(data_dir, policy);
        let options = Options { cache_bytes: 1 << 20, segment_bytes: 1 << 20, ..usual };
        let store = Arc::new(EmbeddedStore::open(&options).unwrap());
        for upload in &uploads {
            store.commit(upload.clone()).unwrap();
        }
        let state = HttpState {
            store: store.clone(),
            operations: store.clone(),
            expectations: Arc::new(Expectations::new(store.clone(), Search::default(), Integrity::default())),
            alarm_limits: AlarmLimits::default(),
            feed: Arc::default(),
            metrics: Arc::default(),
            health: Arc::default(),
            spool_dir: std::env::temp_dir(),
            address_share: 1.0,
            ending: watch::Sender::new(false).subscribe(),
        };
        let rates = Arc::new(Rates::of(&RatesConfig::default()));
        let router = router_at(state, Place::any(), (Arc::new(gate), rates));
        let site = Self { store, uploads, router, _dir: dir };
        site.caught_up().await;
        site
    }

    /// Waits until the map shows all that was decided.
    pub async fn caught_up(&self) {
        let done =
            |p: &MapProgress| p.state == MapStatus::Serving && p.epoch == p.journaled && p.building.is_none();
        self.store.progress().wait_for(done).await.unwrap();
    }

    pub async fn get(&self, path: &str) -> Response {
        let request = Request::builder().uri(path).body(Body::empty()).unwrap();
        self.router.clone().oneshot(request).await.unwrap()
    }

    pub async fn post(&self, path: &str, body: &serde_json::Value) -> Response {
        self.send(path, "application/json", body.to_string().into_bytes()).await
    }

    pub async fn send(&self, path: &str, kind: &str, body: Vec<u8>) -> Response {
        let request = Request::builder().method(Method::POST).uri(path).header("content-type", kind);
        self.router.clone().oneshot(request.body(Body::from(body)).unwrap()).await.unwrap()
    }
}

/// A gate that takes whoever comes for this role.
pub fn gate_of(role: &str) -> Gate {
    let identity = IdentityConfig { anonymous: role.to_owned(), ..IdentityConfig::default() };
    let tls = TlsConfig { reload_s: 1, ..TlsConfig::default() };
    Gate::of(&tls, &identity, &[]).unwrap()
}

pub async fn bytes_of(response: Response) -> Bytes {
    to_bytes(response.into_body(), 16 << 20).await.unwrap()
}

pub async fn json_of(response: Response) -> serde_json::Value {
    serde_json::from_slice(&bytes_of(response).await).unwrap()
}

/// The pixels of a PNG, row by row.
pub async fn pixels_of(response: Response) -> Vec<[u8; 4]> {
    assert_eq!(
        (response.status().as_u16(), &response.headers()["content-type"]),
        (200, &"image/png".parse().unwrap())
    );
    let mut reader = png::Decoder::new(Cursor::new(bytes_of(response).await)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    pixels.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect()
}

pub fn a_fix() -> FixEvent {
    FixEvent {
        answered_us: 1,
        status: "USABLE",
        reason: "unique peak".to_owned(),
        latitude_deg: 30.2672,
        longitude_deg: -97.7431,
        yaw_rad: 0.3,
        prior_latitude_deg: 30.267_21,
        prior_longitude_deg: -97.743_11,
        correction_m: 1.25,
        matched_fraction: 0.7,
        protection_m: Some(0.8),
        align_ms: 12.0,
    }
}

pub fn an_upload() -> UploadEvent {
    UploadEvent {
        answered_us: 1,
        upload_id: Uuid::nil().to_string(),
        outcome: "COUNTED".to_owned(),
        detections_counted: 1000,
        detections_dropped: 3,
        tiles: 9,
        epoch: 7,
    }
}
