//! The map as files: regions out and in, backups.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::{Body, BodyDataStream};
use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Query, Request, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use echofix_core::geo::{Grid, TileId};
use echofix_core::time::day_of;
use serde::Deserialize;
use tokio::io::{AsyncSeekExt, AsyncWriteExt};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::SendTimeoutError;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;

use super::App;
use super::answers::{BUSY, ErrorAnswer, ImportedAnswer};
use super::error::Error;
use super::meridians::Meridians;
use super::operations::{audit, decision, fresh};
use super::raster::corners;
use super::region_days::DatedRegion;
use crate::grpc::now_us;
use crate::identity::Caller;
use crate::pace::{Ahead, Pace, TooSlow};
use crate::shares::Peer;
use crate::store::{self, MapStore, Operations, Region};
use crate::trace::in_current_span;

/// Bytes handed on at a time.
const CHUNK: usize = 64 << 10;
/// Chunks on the way.
const CHUNKS: usize = 16;
/// Bytes of an imported file, at most.
const MAX_IMPORT: u64 = 4 << 30;
/// How slowly a file may be taken.
const TAKEN: Pace = Pace { stall: Duration::from_secs(30), least_per_s: 64 << 10 };
const BINARY: &str = "application/octet-stream";

/// `?box=west,south,east,north`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ExportQuery {
    /// West, south, east, north in degrees, separated by commas; across the date line, west is the larger one. All of the
    /// map without it.
    #[param(example = "11.5,48.1,11.6,48.2")]
    r#box: Option<String>,
}

/// `GET /api/v1/map/export?box=`
#[utoipa::path(
    get,
    path = "/api/v1/map/export",
    operation_id = "exportRegion",
    tag = "files",
    summary = "A region's map as one file.",
    description = "",
    params(ExportQuery),
    responses(
        (status = 200, description = "The file.", body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 400, description = "Not a box.", body = ErrorAnswer),
        (status = 404, description = "There is no map in the box.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn export(
    State(app): State<Arc<App>>,
    peer: Peer,
    area: Result<Query<ExportQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let bounds = area?.0.r#box.as_deref().map_or(Ok([-180.0, -90.0, 180.0, 90.0]), bounds)?;
    let store = Arc::clone(&app.state.store);
    let tiles = app.limiter.work(peer, move || inside(&*store, bounds)).await?;
    if tiles.is_empty() {
        return Err(Error::NotFound("there is no map in this box".to_owned()));
    }
    let region = Region { bounds_deg: bounds, tiles };
    streamed((&app, peer), BINARY, "echofix-region.efx", move |operations, out| {
        operations.export(&region, out)
    })
}

/// A file in the data directory that is as old as the last backup.
pub const LAST_BACKUP: &str = "last-backup";

/// `GET /api/v1/map/backup`
#[utoipa::path(
    get,
    path = "/api/v1/map/backup",
    operation_id = "backUp",
    tag = "files",
    summary = "A consistent copy of the store as a tar archive: a backup. It holds the key that contributors are hashed with: treat it as a secret.",
    description = "",
    responses(
        (status = 200, description = "The archive.", body = Vec<u8>, content_type = "application/x-tar"),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn backup(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
) -> Result<Response, Error> {
    audit(&caller, "take a backup", None, None);
    let note = app.state.spool_dir.join(LAST_BACKUP);
    streamed((&app, peer), "application/x-tar", "echofix-backup.tar", move |operations, out| {
        let bytes = operations.backup(out)?;
        // Its time says when: metrics tell how old the last backup is, after a restart, too.
        if let Err(error) = File::create(&note) {
            tracing::warn!(%error, "when the backup was taken could not be noted");
        }
        Ok(bytes)
    })
}

/// `POST /api/v1/map/import`
///
/// The file is received whole before the map hears of it: at its sender's pace it holds no permit but its own.
#[utoipa::path(
    post,
    path = "/api/v1/map/import",
    operation_id = "importRegion",
    tag = "files",
    summary = "Add an exported region to the map. It counts once, by the file's id.",
    description = "",
    request_body(content = Vec<u8>, content_type = "application/octet-stream", description = "The file, 4 GiB at most."),
    responses(
        (status = 200, description = "It is on disk; the map shows it from its epoch on.", body = ImportedAnswer),
        (status = 400, description = "Not a whole and sound file; nothing of it counts.", body = ErrorAnswer),
        (status = 408, description = "The file comes too slowly.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn import(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    request: Request,
) -> Result<Response, Error> {
    // A page elsewhere may not send this type without being allowed to.
    if request.headers().get(header::CONTENT_TYPE).is_none_or(|kind| kind != BINARY) {
        return Err(Error::BadRequest(format!("send the file as {BINARY}")));
    }
    let place = app.limiter.transfer(peer)?;
    let file = received(&app.state.spool_dir, request.into_body().into_data_stream()).await?;
    let imported = decision(&app, move |operations| {
        let _held = place;
        let mut file = DatedRegion::new(BufReader::new(file), day_of(now_us()));
        let imported = operations.import(&mut file);
        if let Some(reason) = file.refused() {
            return Err(Error::BadRequest(reason));
        }
        let imported = imported?;
        // Here, since who hangs up ends the request, and not what it began.
        audit(&caller, &format!("import file {}", imported.file), None, Some(imported.epoch));
        Ok(imported)
    });
    let imported = imported.await?;
    Ok(fresh(ImportedAnswer {
        file: imported.file.to_string(),
        tiles: imported.tiles,
        known: imported.known,
        epoch: imported.epoch,
    }))
}

/// A body as a file without a name, which is gone with its last handle.
async fn received(dir: &Path, mut body: BodyDataStream) -> Result<File, Error> {
    let dir = dir.to_owned();
    let unnamed = tokio::task::spawn_blocking(move || tempfile::tempfile_in(dir)).await?;
    let mut file = tokio::fs::File::from_std(unnamed.map_err(Error::Spool)?);
    let mut left = MAX_IMPORT;
    while let Some(chunk) = body.next().await {
        let chunk = chunk.map_err(|error| not_received(&error))?;
        let larger = || Error::BadRequest(format!("the file is larger than {MAX_IMPORT} bytes"));
        left = left.checked_sub(chunk.len() as u64).ok_or_else(larger)?;
        file.write_all(&chunk).await.map_err(Error::Spool)?;
    }
    file.flush().await.map_err(Error::Spool)?;
    file.rewind().await.map_err(Error::Spool)?;
    Ok(file.into_std().await)
}

/// A body that ended early: too slow, or its peer is gone.
fn not_received(error: &axum::Error) -> Error {
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = cause {
        if let Some(slow) = error.downcast_ref::<TooSlow>() {
            return Error::TooSlow(*slow);
        }
        cause = error.source();
    }
    Error::BadRequest(format!("the file did not come whole: {error}"))
}

/// A file that is sent while it is made. When making it fails, the connection breaks, so that half a
/// file is not taken for a whole one.
fn streamed(
    (app, peer): (&App, Peer),
    kind: &'static str,
    name: &str,
    make: impl FnOnce(&dyn Operations, &mut dyn Write) -> Result<u64, store::Error> + Send + 'static,
) -> Result<Response, Error> {
    let (sender, receiver) = mpsc::channel::<io::Result<Bytes>>(CHUNKS);
    let operations = Arc::clone(&app.state.operations);
    let place = app.limiter.transfer(peer)?;
    tokio::task::spawn_blocking(in_current_span(move || {
        let _held = place;
        let (ahead, runtime) = (Ahead::new(TAKEN), Handle::current());
        let mut out = BufWriter::with_capacity(CHUNK, BodyWriter { sender: sender.clone(), ahead, runtime });
        let made = make(&*operations, &mut out).map_err(NotSent::from);
        if let Err(error) = made.and_then(|_| Ok(out.flush()?)) {
            tracing::warn!(%error, "a file was not sent whole");
            // The reader may be gone, or take nothing.
            let _ = sender.try_send(Err(io::Error::other(error)));
        }
    }));
    let disposition = format!("attachment; filename=\"{name}\"");
    let headers = [
        (header::CONTENT_TYPE, kind.to_owned()),
        (header::CONTENT_DISPOSITION, disposition),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ];
    Ok((headers, Body::from_stream(ReceiverStream::new(receiver))).into_response())
}

/// Why a file was not sent whole.
#[derive(Debug, thiserror::Error)]
enum NotSent {
    #[error(transparent)]
    Store(#[from] store::Error),
    #[error("the rest could not be sent: {0}")]
    Rest(#[from] io::Error),
}

/// Hands a file on, as fast as its reader takes it, and fails when that is too slow.
struct BodyWriter {
    sender: mpsc::Sender<io::Result<Bytes>>,
    ahead: Ahead,
    runtime: Handle,
}

impl Write for BodyWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let now = Instant::now();
        let patience = self.ahead.until(now).saturating_duration_since(now);
        let sending = self.sender.send_timeout(Ok(Bytes::copy_from_slice(bytes)), patience);
        self.runtime.block_on(sending).map_err(|error| match error {
            SendTimeoutError::Timeout(_) => io::Error::from(io::ErrorKind::TimedOut),
            SendTimeoutError::Closed(_) => io::Error::from(io::ErrorKind::BrokenPipe),
        })?;
        self.ahead.came(bytes.len(), Instant::now());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// West, south, east, north, degrees.
fn bounds(text: &str) -> Result<[f64; 4], Error> {
    let malformed = || {
        Error::BadRequest(
            "box must be west,south,east,north in degrees; across the date line, west is the larger one"
                .to_owned(),
        )
    };
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let bounds: [f64; 4] = numbers.ok().and_then(|numbers| numbers.try_into().ok()).ok_or_else(malformed)?;
    let [west, south, east, north] = bounds;
    let sound = (-180.0..=180.0).contains(&west)
        && (-180.0..=180.0).contains(&east)
        && (-90.0..=90.0).contains(&south)
        && (-90.0..=90.0).contains(&north);
    if sound && south <= north { Ok(bounds) } else { Err(malformed()) }
}

/// The tiles that touch a box.
fn inside(store: &dyn MapStore, [west, south, east, north]: [f64; 4]) -> Result<Vec<TileId>, Error> {
    let all = i32::MIN..=i32::MAX;
    let meridians = Meridians::between(west, east);
    let mut tiles = Vec::new();
    for zone in store.zones() {
        let grid = Grid::new(zone)?;
        for info in store.catalog(zone, all.clone(), all.clone())? {
            let corners = corners(&grid, [info.id.x, info.id.y], [info.id.x, info.id.y])?;
            let lowest = corners.iter().map(|at| at.lat_deg).fold(f64::INFINITY, f64::min);
            let highest = corners.iter().map(|at| at.lat_deg).fold(f64::NEG_INFINITY, f64::max);
            let across = Meridians::around(corners.map(|at| Meridians::between(at.lon_deg, at.lon_deg)));
            if highest >= south && lowest <= north && across.is_some_and(|across| across.meets(meridians)) {
                tiles.push(info.id);
            }
        }
    }
    Ok(tiles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::{StoredSite, bytes_of, json_of};
    use serde_json::json;

    #[tokio::test]
    async fn a_region_goes_out_of_one_map_and_into_another() {
        let (here, there) = (StoredSite::with_uploads(5).await, StoredSite::with_uploads(0).await);
        let file = bytes_of(here.get("/api/v1/map/export").await).await;
        let response = there.send("/api/v1/map/import", BINARY, file.to_vec()).await;
        assert_eq!(response.status(), 200);
        let imported = json_of(response).await;
        assert_eq!((&imported["known"], &imported["epoch"]), (&json!(0), &imported["tiles"]));
        there.caught_up().await;
        let tiles = |body: serde_json::Value| body["totals"].clone();
        let (ours, theirs) = (
            tiles(json_of(here.get("/api/v1/map").await).await),
            tiles(json_of(there.get("/api/v1/map").await).await),
        );
        assert_eq!((&ours["tiles"], &ours["cells"]), (&theirs["tiles"], &theirs["cells"]));
        let half = there.send("/api/v1/map/import", BINARY, file[..file.len() / 2].to_vec()).await;
        assert_eq!(half.status(), 400);
    }

    #[tokio::test]
    async fn a_box_is_checked_and_cuts() {
        let site = StoredSite::with_uploads(5).await;
        for (area, status) in
            [("0,0,1,1", 404), ("1,2,3", 400), ("9,0,8,1", 200), ("9,1,8,0", 400), ("0,NaN,1,1", 400)]
        {
            assert_eq!(site.get(&format!("/api/v1/map/export?box={area}")).await.status(), status, "{area}");
        }
        let whole = bytes_of(site.get("/api/v1/map/export").await).await;
        let part = bytes_of(site.get("/api/v1/map/export?box=-180,-1,180,1").await).await;
        assert!(part.len() < whole.len(), "the tiles far in the south are left out");
    }

    #[tokio::test]
    async fn a_backup_is_a_whole_archive() {
        let site = StoredSite::with_uploads(3).await;
        let response = site.get("/api/v1/map/backup").await;
        assert_eq!(response.headers()["content-type"], "application/x-tar");
        let archive = bytes_of(response).await;
        assert!(archive.starts_with(b"key\0") && archive.ends_with(&[0; 1024]));
    }
}
