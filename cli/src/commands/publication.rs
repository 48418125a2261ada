//! What of an upload is served, and what waits for more contributors.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use echofix_client::service::{CallerChannel, ServiceEndpoint};
use echofix_core::geo::{Grid, LatLon, TileId, Zone};
use echofix_harness::uploading::{Publication, UploadedDrive};
use echofix_proto::v1::map_service_client::MapServiceClient;
use echofix_proto::v1::{GetCoverageRequest, GetCoverageResponse};

/// Points of one question, at most: what the service takes.
const POINTS: usize = 4_096;
/// How long folding is waited for: usually it takes far less.
const PATIENCE: Duration = Duration::from_secs(10);
/// How often it is asked whether the uploads are folded.
const PAUSE: Duration = Duration::from_millis(100);

/// Asks the service what is served of the tiles of a drive's uploads, once they are folded. `None` where it does not fold them in
/// time, or does not tell: the uploads are acknowledged all the same.
pub(super) async fn publication(service: &ServiceEndpoint, done: &UploadedDrive) -> Option<Publication> {
    let mut client = MapServiceClient::new(service.connect_lazy());
    let asked = async {
        reached(&mut client, done.epoch).await.ok()?;
        of_tiles(&mut client, &done.tiles).await.ok()
    };
    tokio::time::timeout(PATIENCE, asked).await.ok().flatten()
}

/// Waits until the map is folded up to an epoch.
async fn reached(client: &mut MapServiceClient<CallerChannel>, epoch: u64) -> anyhow::Result<()> {
    let began = Instant::now();
    while client.get_coverage(GetCoverageRequest::default()).await?.into_inner().epoch < epoch {
        anyhow::ensure!(began.elapsed() < PATIENCE, "the uploads are not folded yet");
        tokio::time::sleep(PAUSE).await;
    }
    Ok(())
}

async fn of_tiles(
    client: &mut MapServiceClient<CallerChannel>,
    tiles: &BTreeSet<(u32, i32, i32)>,
) -> anyhow::Result<Publication> {
    let centres: Vec<LatLon> = tiles.iter().filter_map(centre).collect();
    let mut found = Publication { tiles: centres.len() as u64, ..Publication::default() };
    for part in centres.chunks(POINTS) {
        let request = GetCoverageRequest {
            latitude_deg: part.iter().map(|at| at.lat_deg).collect(),
            longitude_deg: part.iter().map(|at| at.lon_deg).collect(),
            expectations: false,
        };
        count(&client.get_coverage(request).await?.into_inner(), &mut found);
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
fn centre((epsg, x, y): &(u32, i32, i32)) -> Option<LatLon> {
    let id = TileId { zone: Zone::from_epsg(*epsg).ok()?, y: *y, x: *x };
    Grid::new(id.zone).ok()?.unproject(id.centre()).ok()
}
