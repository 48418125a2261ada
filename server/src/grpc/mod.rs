//! gRPC for vehicles: decode and validate, call the domain, encode. No domain logic here.
//!
//! - [`invalid_field`], [`decode`]: columns of the contract to values of the core, or the path of the
//!   field that breaks a rule.
//! - [`status`]: every error as a `tonic::Status` with `google.rpc` details.
//! - [`localize`], [`upload`], [`get_tiles`], [`get_coverage`]: one RPC each.

pub mod decode;
mod get_coverage;
mod get_tiles;
mod invalid_field;
mod localize;
pub mod status;
mod upload;

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use echofix_proto::v1;
use tonic::{Request, Response, Status, Streaming};

use crate::locating::Expectations;
use crate::store::MapStore;
use crate::trace::in_current_span;
pub use localize::LocalizationApi;
pub use upload::MappingApi;

/// Serves tiles and coverage.
pub struct MapApi {
    store: Arc<dyn MapStore>,
    expectations: Arc<Expectations>,
    reads: Arc<tokio::sync::Semaphore>,
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
        Self { store, expectations, reads: Arc::new(tokio::sync::Semaphore::new(at_once)), stall }
    }

    /// The permit to read.
    fn reader(&self) -> Result<tokio::sync::OwnedSemaphorePermit, Status> {
        let busy = |_| status::overloaded("too many readers at once", std::time::Duration::from_secs(1));
        self.reads.clone().try_acquire_owned().map_err(busy)
    }
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
        let permit = self.reader()?;
        let known = (self.store.clone(), self.expectations.clone());
        get_coverage::get_coverage(known, request.into_inner(), permit).await.map(Response::new)
    }
}

#[tonic::async_trait]
impl v1::mapping_service_server::MappingService for MappingApi {
    async fn upload(
        &self,
        request: Request<Streaming<v1::UploadRequest>>,
    ) -> Result<Response<v1::UploadResponse>, Status> {
        self.receive(request.into_inner()).await.map(Response::new)
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

/// Microseconds since the Unix epoch.
pub(crate) fn now_us() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_micros() as i64)
}

/// A tile id as it is on the wire.
pub(crate) fn tile_id(id: echofix_core::geo::TileId) -> v1::TileId {
    v1::TileId { epsg: u32::from(id.zone.epsg()), x: id.x, y: id.y }
}
