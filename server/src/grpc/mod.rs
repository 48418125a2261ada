//! gRPC for vehicles: decode and validate, call the domain, encode. No domain logic here.
//!
//! - [`invalid_field`], [`decode`]: columns of the contract to values of the core, or the path of the
//!   field that breaks a rule.
//! - [`admission`]: what no slot could take is refused on its headers.
//! - [`access`]: who calls, and whether they may.
//! - [`faults`]: what the transport could not read is the caller's fault.
//! - [`status`]: every error as a `tonic::Status` with `google.rpc` details.
//! - [`localize`], [`upload`], [`get_tiles`], [`get_coverage`]: one RPC each.

mod access;
mod admission;
pub mod decode;
mod faults;
mod get_coverage;
mod get_tiles;
mod heads;
mod invalid_field;
mod localize;
pub mod status;
mod upload;

use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use echofix_core::demand::DemandPolicy;
use echofix_proto::v1;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tonic::{Request, Response, Status, Streaming};

use crate::lanes::{Lanes, run_on};
use crate::locating::Expectations;
use crate::pace::Pace;
use crate::patience::Patience;
use crate::shares::{Peer, Place, Pool};
use crate::store::MapStore;
use crate::trace::in_current_span;
pub use access::Access;
pub use admission::Admission;
pub use faults::tell as tell_faults;
pub use heads::HeadsLayer;
pub use localize::{INTEGRITY_RISKS, LocalizationApi};
pub use upload::MappingApi;

/// One of so many readers may ask for expectations.
const EXPECTING_SHARE: usize = 8;
/// Requests that may be open for each that reads.
const OPEN_FOR_ONE: usize = 4;

/// Serves tiles and coverage.
pub struct MapApi {
    store: Arc<dyn MapStore>,
    expectations: Arc<Expectations>,
    demand: DemandPolicy,
    /// Requests that are being answered, at their callers' pace.
    open: Arc<Pool>,
    /// Those of them that read the map.
    reads: Arc<Semaphore>,
    /// Of those that ask for expectations, which are made one at a time: others must not wait behind them.
    expecting: Arc<Pool>,
    lanes: Lanes,
    pace: Pace,
}

impl MapApi {
    /// Reads from `store`, at most `at_once` requests at a time, of which one peer may have a share; a caller that takes what it
    /// asked for more slowly than the pace is given up.
    #[must_use]
    pub fn new(
        store: Arc<dyn MapStore>,
        (expectations, demand): (Arc<Expectations>, DemandPolicy),
        (at_once, address_share): (usize, f64),
        (pace, lanes): (Pace, Lanes),
    ) -> Self {
        let open = Pool::new(OPEN_FOR_ONE * at_once, address_share);
        let expecting = Pool::new(at_once.div_ceil(EXPECTING_SHARE), address_share);
        let reads = Arc::new(Semaphore::new(at_once));
        Self { store, expectations, demand, open, reads, expecting, lanes, pace }
    }
}

/// A peer's place in a pool.
fn place(pool: &Arc<Pool>, peer: Peer, message: &str) -> Result<Place, Status> {
    pool.take(peer).ok_or_else(|| status::overloaded(message, Duration::from_secs(1)))
}

/// Whose connection a call came by.
fn peer(extensions: &tonic::Extensions) -> Peer {
    extensions.get().copied().unwrap_or_else(Peer::unknown)
}

#[tonic::async_trait]
impl v1::map_service_server::MapService for MapApi {
    type GetTilesStream = get_tiles::TileStream;

    async fn get_tiles(
        &self,
        request: Request<v1::GetTilesRequest>,
    ) -> Result<Response<Self::GetTilesStream>, Status> {
        let place = place(&self.open, peer(request.extensions()), "too many readers at once")?;
        let reader = get_tiles::Reader { store: self.store.clone(), reads: self.reads.clone() };
        let call = get_tiles::get_tiles(reader, request.into_inner(), place, self.pace);
        run_on(&self.lanes.background, call).await.map(Response::new)
    }

    async fn get_coverage(
        &self,
        request: Request<v1::GetCoverageRequest>,
    ) -> Result<Response<v1::GetCoverageResponse>, Status> {
        let peer = peer(request.extensions());
        let expects = request.get_ref().expectations;
        let busy = "too many ask for expectations at once";
        let expecting = expects.then(|| place(&self.expecting, peer, busy)).transpose()?;
        let places = (place(&self.open, peer, "too many readers at once")?, expecting);
        let known = (self.store.clone(), self.expectations.clone(), self.demand);
        let reads = self.reads.clone();
        let call = async move {
            let permit = reads.acquire_owned().await.map_err(|_| status::gone())?;
            get_coverage::get_coverage(known, request.into_inner(), (permit, places)).await
        };
        run_on(&self.lanes.background, call).await.map(Response::new)
    }
}

#[tonic::async_trait]
impl v1::mapping_service_server::MappingService for MappingApi {
    async fn upload(
        &self,
        request: Request<Streaming<v1::UploadRequest>>,
    ) -> Result<Response<v1::UploadResponse>, Status> {
        let caller = access::caller(request.extensions())?;
        let (this, peer, messages) = (self.clone(), peer(request.extensions()), request.into_inner());
        // Messages are unpacked where they are awaited.
        let call = async move { this.receive(messages, peer, &caller).await };
        run_on(&self.lanes().background, call).await.map(Response::new)
    }
}

/// Runs what may block on the disk or compute for long, off the async threads.
///
/// It runs to its end even when the caller goes away, in the span of the request.
pub(crate) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Status> {
    tokio::task::spawn_blocking(in_current_span(work)).await.map_err(|error| status::torn(&error))
}

/// Runs what may block or compute for long while its caller waits: it looks at the [`Patience`] between its steps, and
/// ends with [`status::gone`] when that is over.
pub(crate) async fn attended<T: Send + 'static>(
    lane: &Handle,
    deadline: Option<Instant>,
    work: impl FnOnce(&Patience) -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    // Dropped with this future, when the caller goes away or its deadline passes.
    let (patience, _waiting) = Patience::until(deadline);
    let done = lane.spawn_blocking(in_current_span(move || work(&patience))).await;
    done.map_err(|error| status::torn(&error))?
}

/// Microseconds since the Unix epoch.
pub(crate) fn now_us() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_micros() as i64)
}

/// A tile id as it is on the wire.
pub(crate) fn tile_id(id: echofix_core::geo::TileId) -> v1::TileId {
    v1::TileId { epsg: u32::from(id.zone.epsg()), x: id.x, y: id.y }
}
