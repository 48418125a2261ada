//! A history of many uploads: to look at, and to start on.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use anyhow::Context;
use echofix_core::evidence::{CellHits, EvidenceDelta, TileEvidence, codec};
use echofix_core::geo::{CellIndex, Grid, LatLon, TileId};
use echofix_core::point::MapPoint;
use echofix_core::time::DAY_US;
use echofix_harness::percentiles::Percentiles;
use echofix_harness::process::ServiceProcess;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{EvidenceChunk, UploadHeader, UploadRequest};
use serde::Serialize;
use tokio::task::JoinSet;
use tonic::transport::Endpoint;
use uuid::Uuid;

use super::Browser;
use crate::machine::held_by;

/// Uploads that are under way at the same time.
const AT_ONCE: u64 = 64;
/// Contributors, and days over which they come.
const CONTRIBUTORS: u64 = 500;
const DAYS: u64 = 60;
/// Along a street, from one upload to the next place, metres.
const STEP_M: f64 = 25.0;
/// Places.
const PLACES: u64 = 400;
/// Looks at a page of the history.
const LOOKS: usize = 50;
/// The day of the first upload, counted from the Unix epoch.
const FIRST_DAY: i64 = 20_000;

/// What was waited for.
#[derive(Debug, Clone, Serialize)]
pub(super) struct History {
    /// Uploads.
    pub(super) uploads: u64,
    /// Seconds until all were acknowledged, and until the map showed them.
    pub(super) acknowledged_s: f64,
    pub(super) folded_s: f64,
    /// Milliseconds of a page of the history, of the map in numbers and of the feed.
    pub(super) page_ms: Percentiles,
    pub(super) map_ms: Percentiles,
    pub(super) feed_ms: Percentiles,
    /// Seconds of a start on it, until the service is ready.
    pub(super) start_s: f64,
    /// The service's memory after the start, MB.
    pub(super) memory_mb: Option<f64>,
}

/// Makes so many small uploads, and looks at what they leave.
///
/// # Errors
/// When the service does not start, refuses an upload, or does not answer.
pub(super) async fn measure(uploads: u64, folder: &Path) -> anyhow::Result<History> {
    std::fs::create_dir_all(folder)?;
    // The evidence is of one time, whatever the clock says.
    let settings = ["mapping.retention_days=36500".to_owned()];
    let service = ServiceProcess::start(folder, &settings).await?;
    let began = Instant::now();
    upload_all(&service.grpc, uploads).await?;
    let acknowledged_s = began.elapsed().as_secs_f64();
    service.folded().await?;
    let folded_s = began.elapsed().as_secs_f64();
    service.stop().await?;

    let began = Instant::now();
    let service = ServiceProcess::start(folder, &settings).await?;
    service.folded().await?;
    let start_s = began.elapsed().as_secs_f64();
    let browser = Browser::at(&service.http);
    let [page_ms, map_ms, feed_ms] = tokio::task::spawn_blocking(move || {
        let of = |path| browser.often(path, LOOKS);
        Ok::<_, anyhow::Error>([
            of("api/v1/map/history?limit=100")?,
            of("api/v1/map")?,
            of("api/v1/uploads")?,
        ])
    })
    .await??;
    let memory_mb = held_by(service.pid()).map(|kibibytes| kibibytes as f64 * 1024e-6);
    service.stop().await?;
    Ok(History { uploads, acknowledged_s, folded_s, page_ms, map_ms, feed_ms, start_s, memory_mb })
}

async fn upload_all(grpc: &str, uploads: u64) -> anyhow::Result<()> {
    let evidence: Arc<Vec<Vec<u8>>> = Arc::new((0..PLACES).map(evidence).collect::<anyhow::Result<_>>()?);
    let (mut senders, next) = (JoinSet::new(), Arc::new(AtomicU64::new(0)));
    for _ in 0..AT_ONCE {
        let channel = Endpoint::from_shared(grpc.to_owned())?.connect().await?;
        let (evidence, next) = (Arc::clone(&evidence), Arc::clone(&next));
        senders.spawn(async move {
            let mut client = MappingServiceClient::new(channel);
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                if number >= uploads {
                    return Ok(());
                }
                let parts = upload(number, &evidence[(number % PLACES) as usize]);
                while let Err(refused) = client.upload(tokio_stream::iter(parts.clone())).await {
                    // Folding is behind: as a vehicle would, later once more.
                    if ![tonic::Code::ResourceExhausted, tonic::Code::Unavailable].contains(&refused.code()) {
                        return Err(refused);
                    }
                    tokio::time::sleep(std::time::Duration::from_millis(100)).await;
                }
            }
        });
    }
    while let Some(sent) = senders.join_next().await {
        sent.context("an upload broke down")?.context("an upload was refused")?;
    }
    Ok(())
}

/// What is seen at a place: some cells of a wall beside the street.
fn evidence(place: u64) -> anyhow::Result<Vec<u8>> {
    let grid = Grid::of(LatLon { lat_deg: 30.2672, lon_deg: -97.7431 })?;
    let start = grid.project(LatLon { lat_deg: 30.2672, lon_deg: -97.7431 })?;
    let mut delta = EvidenceDelta::default();
    for step in 0..40 {
        let at = MapPoint::new(start.x_m + STEP_M * place as f64 + 0.5 * f64::from(step), start.y_m);
        let (id, index) = TileId::locate(grid.zone(), CellIndex::of(at));
        let tile = delta.tiles.entry(id).or_insert_with(|| TileEvidence::of_hits(Vec::new()));
        tile.cells.push(CellHits { index, hits: 2, offset_sum: [256; 2] });
    }
    for tile in delta.tiles.values_mut() {
        tile.cells.sort_by_key(|cell| cell.index);
        *tile = TileEvidence::of_hits(std::mem::take(&mut tile.cells));
    }
    delta.detections = delta.tiles.values().map(TileEvidence::detections).sum();
    Ok(codec::encode(&delta))
}

fn upload(number: u64, contribution: &[u8]) -> Vec<UploadRequest> {
    let day = FIRST_DAY + (number * DAYS / 100_000) as i64 % DAYS as i64;
    let header = UploadHeader {
        upload_id: Uuid::from_u64_pair(1, number).to_string(),
        contributor: format!("contributor-{}", number % CONTRIBUTORS),
        reference_time_us: day * DAY_US,
        ..UploadHeader::default()
    };
    let chunk =
        EvidenceChunk { contribution: contribution.to_vec(), sigma_position_m: 0.1, sigma_yaw_rad: 0.002 };
    [Part::Header(header), Part::Evidence(chunk)]
        .into_iter()
        .map(|part| UploadRequest { part: Some(part) })
        .collect()
}
