//! What of an upload is served, what waits for more contributors, and what is wanted at all.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use echofix_client::CoverageClient;
use echofix_client::service::ServiceEndpoint;
use echofix_client::upload::Demand;
use echofix_core::drive::Drive;
use echofix_core::geo::{Grid, LatLon, TileId, Zone};
use echofix_core::time::day_of;
use echofix_harness::uploading::{Publication, UploadedDrive};
use echofix_proto::v1::GetCoverageResponse;

/// How long folding is waited for: usually it takes far less.
const PATIENCE: Duration = Duration::from_secs(10);
/// How often it is asked whether the uploads are folded.
const PAUSE: Duration = Duration::from_millis(100);

/// Asks the service what is served of the tiles of a drive's uploads, once they are folded. `None` where it does not fold them in
/// time, or does not tell: the uploads are acknowledged all the same.
pub(super) async fn publication(service: &ServiceEndpoint, done: &UploadedDrive) -> Option<Publication> {
    let client = CoverageClient::new(service);
    let asked = async {
        reached(&client, done.epoch).await.ok()?;
        of_tiles(&client, &done.tiles).await.ok()
    };
    tokio::time::timeout(PATIENCE, asked).await.ok().flatten()
}

/// Waits until the map is folded up to an epoch.
async fn reached(client: &CoverageClient, epoch: u64) -> anyhow::Result<()> {
    let began = Instant::now();
    while client.ask(&[]).await?.iter().all(|(_, map)| map.epoch < epoch) {
        anyhow::ensure!(began.elapsed() < PATIENCE, "the uploads are not folded yet");
        tokio::time::sleep(PAUSE).await;
    }
    Ok(())
}

/// What the service wants of the places along a drive, on its day.
///
/// # Errors
/// When the service does not say.
pub(super) async fn wanted(drive: &Drive, service: &ServiceEndpoint) -> anyhow::Result<Arc<Demand>> {
    let demand = Demand::of(&drive.vehicle);
    let places: BTreeSet<_> = drive.reference.iter().filter_map(|pose| TileId::at(pose.at).ok()).collect();
    // What a radar sees lies in the tiles around.
    let near: BTreeSet<_> = places.iter().flat_map(|id| id.with_neighbours()).collect();
    let points: Vec<_> = near.iter().filter_map(centre).collect();
    let today = drive.reference.first().map_or(0, |pose| day_of(pose.time_us));
    let answers = CoverageClient::new(service).ask(&points).await.context("asking what is wanted")?;
    for (part, answer) in &answers {
        demand.learn_coverage(part, answer, today);
    }
    Ok(Arc::new(demand))
}

async fn of_tiles(client: &CoverageClient, tiles: &BTreeSet<(u32, i32, i32)>) -> anyhow::Result<Publication> {
    let id = |(epsg, x, y): &(u32, i32, i32)| {
        let zone = Zone::from_epsg(*epsg).ok()?;
        Some(TileId { zone, y: *y, x: *x })
    };
    let centres: Vec<LatLon> = tiles.iter().filter_map(id).filter_map(|id| centre(&id)).collect();
    let mut found = Publication { tiles: centres.len() as u64, ..Publication::default() };
    for (_, coverage) in client.ask(&centres).await? {
        count(&coverage, &mut found);
    }
    Ok(found)
}

fn count(coverage: &GetCoverageResponse, found: &mut Publication) {
    found.needed = coverage.contributors_needed;
    for contributors in coverage.contributors.iter().filter(|contributors| **contributors > 0) {
        found.waiting += 1;
        found.contributors = found.contributors.max(*contributors);
    }
}

/// The middle of a tile; nothing for one that no zone has.
fn centre(id: &TileId) -> Option<LatLon> {
    Grid::new(id.zone).ok()?.unproject(id.centre()).ok()
}
