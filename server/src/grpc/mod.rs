//! gRPC for vehicles: decode and validate, call the domain, encode. No domain logic here.
//!
//! - [`invalid_field`], [`decode`]: columns of the contract to values of the core, or the path of the
//!   field that breaks a rule.
//! - [`access`]: who calls, and whether they may.
//! - [`faults`]: what the transport could not read is the caller's fault.
//! - [`status`]: every error as a `tonic::Status` with `google.rpc` details.
//! - [`localize`], [`upload`], [`get_tiles`], [`get_coverage`]: one RPC each.

mod access;
pub mod decode;
mod faults;
mod get_coverage;
mod get_tiles;
mod invalid_field;
mod localize;
pub mod status;
mod upload;

use std::sync::Arc;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use echofix_proto::v1;
use tonic::{Request, Response, Status, Streaming};

use crate::locating::Expectations;
use crate::patience::Patience;
use crate::store::MapStore;
use crate::trace::in_current_span;
pub use access::AccessLayer;
pub use faults::FaultsLayer;
pub use localize::{INTEGRITY_RISKS, LocalizationApi};
pub use upload::MappingApi;

/// One of so many readers may ask for expectations.
const EXPECTING_SHARE: usize = 8;

/// Serves tiles and coverage.
pub struct MapApi {
    store: Arc<dyn MapStore>,
    expectations: Arc<Expectations>,
    reads: Arc<tokio::sync::Semaphore>,
    /// Of those that ask for expectations, which are made one at a time: others must not wait behind them.
    expecting: Arc<tokio::sync::Semaphore>,
    stall: std::time::Duration,
}

impl MapApi {
    /// Reads from `store`, at most `at_once` requests at a time; a caller that takes nothing for
    /// as long as `stall` is given up.
    #[must_use]
    pub fn new(
        store: Arc<dyn MapStore>,
        expectations: Arc<Expectations>,
        at_once: usize,
        stall: std::time::Duration,
    ) -> Self {
        let permits = |count| Arc::new(tokio::sync::Semaphore::new(count));
        let (reads, expecting) = (permits(at_once), permits(at_once.div_ceil(EXPECTING_SHARE)));
        Self { store, expectations, reads, expecting, stall }
    }

    /// The permit to read.
    fn reader(&self) -> Result<tokio::sync::OwnedSemaphorePermit, Status> {
        permit(&self.reads, "too many readers at once")
    }

    /// The permit to ask for expectations.
    fn expecter(&self) -> Result<tokio::sync::OwnedSemaphorePermit, Status> {
        permit(&self.expecting, "too many ask for expectations at once")
    }
}

fn permit(
    permits: &Arc<tokio::sync::Semaphore>,
    message: &str,
) -> Result<tokio::sync::OwnedSemaphorePermit, Status> {
    let busy = |_| status::overloaded(message, std::time::Duration::from_secs(1));
    permits.clone().try_acquire_owned().map_err(busy)
}

#[tonic::async_trait]
impl v1::map_service_server::MapService for MapApi {
    type GetTilesStream = get_tiles::TileStream;

    async fn get_tiles(
        &self,
        request: Request<v1::GetTilesRequest>,
    ) -> Result<Response<Self::GetTilesStream>, Status> {
        let permit = self.reader()?;
        get_tiles::get_tiles(self.store.clone(), request.into_inner(), permit, self.stall)
            .await
            .map(Response::new)
    }

    async fn get_coverage(
        &self,
        request: Request<v1::GetCoverageRequest>,
    ) -> Result<Response<v1::GetCoverageResponse>, Status> {
        let expecting = request.get_ref().expectations.then(|| self.expecter()).transpose()?;
        let permits = (self.reader()?, expecting);
        let known = (self.store.clone(), self.expectations.clone());
        get_coverage::get_coverage(known, request.into_inner(), permits).await.map(Response::new)
    }
}

#[tonic::async_trait]
impl v1::mapping_service_server::MappingService for MappingApi {
    async fn upload(
        &self,
        request: Request<Streaming<v1::UploadRequest>>,
    ) -> Result<Response<v1::UploadResponse>, Status> {
        let caller = access::caller(request.extensions())?;
        self.receive(request.into_inner(), &caller).await.map(Response::new)
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
    deadline: Option<Instant>,
    work: impl FnOnce(&Patience) -> Result<T, Status> + Send + 'static,
) -> Result<T, Status> {
    // Dropped with this future, when the caller goes away or its deadline passes.
    let (patience, _waiting) = Patience::until(deadline);
    blocking(move || work(&patience)).await?
}

/// Microseconds since the Unix epoch.
pub(crate) fn now_us() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_micros() as i64)
}

/// A tile id as it is on the wire.
pub(crate) fn tile_id(id: echofix_core::geo::TileId) -> v1::TileId {
    v1::TileId { epsg: u32::from(id.zone.epsg()), x: id.x, y: id.y }
}
