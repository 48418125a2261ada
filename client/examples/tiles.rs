//! Caches the map along a recorded drive's route on disk, and lists it.
//!
//! ```text
//! cargo run -p echofix-client --example tiles -- http://127.0.0.1:50051 drive.mcap
//! ```

use std::error::Error;

use echofix_client::drivelog;
use echofix_client::service::ServiceAddress;
use echofix_client::tiles::{TileCache, TileCacheLimits, Want};
use echofix_core::geo::LatLon;
use tracing::info;

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    tracing_subscriber::fmt().with_target(false).init();
    let mut arguments = std::env::args().skip(1);
    let (Some(url), Some(path)) = (arguments.next(), arguments.next()) else {
        return Err("usage: tiles http://host:port drive.mcap".into());
    };
    let route: Vec<LatLon> = drivelog::read(path)?.drive.reference.iter().map(|pose| pose.at).collect();
    let cache = TileCache::open(std::env::temp_dir().join("echofix-tiles"), TileCacheLimits::default())?;

    let want = Want::along(&route, 100.0)?;
    let done = cache.sync(&ServiceAddress::at(url).endpoint()?, &want).await?;
    info!("{} tiles in {} bytes came, {} were up to date", done.fetched, done.bytes, done.unchanged);
    // From here on without the service.
    for (id, _) in cache.versions() {
        if let Some((version, tile)) = cache.tile(id)? {
            info!("tile {id}, version {version}: {} cells", tile.len());
        }
    }
    Ok(())
}
