//! `echofix tiles`: a copy of the map in a folder, as vehicles keep it.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use echofix_client::tiles::{Synced, TileCache, TileCacheLimits, Want};
use echofix_harness::credentials::Credentials;
use echofix_harness::ranges::within;
use echofix_proto::v1::GeodeticBox;

/// Arguments of `echofix tiles`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    operation: TilesOperation,
}

#[derive(clap::Subcommand)]
enum TilesOperation {
    /// Download the tiles of an area that changed, and remove those that are no longer in the map.
    Sync {
        /// The folder. If an earlier run filled it, it is brought up to date.
        dir: PathBuf,
        /// The area as west,south,east,north in degrees, at most about 3 km by 3 km. Without it: the whole map, if that is
        /// no larger.
        #[arg(long, allow_hyphen_values = true, value_parser = area)]
        area: Option<GeodeticBox>,
        /// URL of the service's gRPC port. Without it, that of the profile, or `http://127.0.0.1:50051`.
        #[arg(long, env = "ECHOFIX_SERVER")]
        server: Option<String>,
        /// Fetch the vehicle layer: all that localizing needs, in a sixth of the bytes of one survey and an eightieth of a crowd's.
        #[arg(long)]
        layer: bool,
        /// Largest size of the folder, megabytes. Beyond it, the tiles that were not used for the longest time are removed.
        #[arg(long, default_value_t = 1_000, value_parser = within(1..=1_000_000_000_u64))]
        max_mb: u64,
    },
}

/// Runs the subcommand.
///
/// # Errors
/// When the service cannot be reached or refuses, or the folder cannot be used.
pub async fn run(args: Args, credentials: &Credentials, json: bool) -> anyhow::Result<()> {
    let TilesOperation::Sync { dir, area, server, layer, max_mb } = args.operation;
    let everywhere = GeodeticBox { south_deg: -90.0, west_deg: -180.0, north_deg: 90.0, east_deg: 180.0 };
    let limits = TileCacheLimits { max_bytes: max_mb.saturating_mul(1_000_000) };
    let cache = TileCache::open(dir, limits)?;
    let service = credentials.endpoint(credentials.server(server.as_deref()))?;
    let want = Want::Area(area.unwrap_or(everywhere));
    let done =
        if layer { cache.sync_layer(&service, &want).await? } else { cache.sync(&service, &want).await? };
    report(&done, &cache, json);
    Ok(())
}

fn report(done: &Synced, cache: &TileCache, json: bool) {
    let Synced { epoch, fetched, bytes, unchanged, removed, evicted } = *done;
    let (tiles, held) = (cache.versions().len(), cache.bytes());
    if json {
        let folder = serde_json::json!({ "tiles": tiles, "bytes": held });
        println!(
            "{}",
            serde_json::json!({
                "epoch": epoch, "fetched": fetched, "bytes": bytes, "unchanged": unchanged,
                "removed": removed, "evicted": evicted, "folder": folder,
            })
        );
        return;
    }
    println!("{fetched} tiles in {:.1} kB, {unchanged} unchanged, {removed} removed", bytes as f64 / 1e3);
    if evicted > 0 {
        println!("{evicted} tiles that were not used for the longest time were removed to make room");
    }
    println!("the folder holds {tiles} tiles in {:.1} kB; the map's epoch is {epoch}", held as f64 / 1e3);
}

fn area(text: &str) -> anyhow::Result<GeodeticBox> {
    let expected = "expected west,south,east,north in degrees, like -97.8,30.2,-97.7,30.3";
    let degrees: Vec<f64> =
        text.split(',').map(|part| part.trim().parse()).collect::<Result<_, _>>().context(expected)?;
    ensure!(degrees.len() == 4, expected);
    let [west_deg, south_deg, east_deg, north_deg] = [degrees[0], degrees[1], degrees[2], degrees[3]];
    for (name, value, most) in [
        ("west", west_deg, 180.0),
        ("south", south_deg, 90.0),
        ("east", east_deg, 180.0),
        ("north", north_deg, 90.0),
    ] {
        ensure!(value.abs() <= most, "{name} is {value}; it must lie within -{most} and {most} degrees");
    }
    ensure!(south_deg <= north_deg, "south, {south_deg}, lies north of north, {north_deg}");
    Ok(GeodeticBox { south_deg, west_deg, north_deg, east_deg })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_are_read_west_first() {
        let read = area("-97.8,30.2, -97.7,30.3").unwrap();
        assert_eq!((read.west_deg, read.north_deg), (-97.8, 30.3));
        for text in ["", "1,2,3", "1,2,3,4,5", "a,b,c,d"] {
            assert!(area(text).unwrap_err().to_string().contains("west,south"), "{text}");
        }
        for (text, words) in [
            ("nan,0,1,1", "west is NaN"),
            ("0,0,1,91", "north is 91; it must lie within -90 and 90"),
            ("181,0,1,1", "west is 181"),
            ("0,2,1,1", "south, 2, lies north"),
        ] {
            assert!(area(text).unwrap_err().to_string().contains(words), "{text}");
        }
        assert!(area("179,-18,-179,-17").is_ok(), "across the date line");
    }
}
