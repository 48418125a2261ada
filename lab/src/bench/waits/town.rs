//! The console's page and the map's tiles of a mapped town.

use std::path::Path;

use anyhow::{Context, ensure};
use echofix_harness::percentiles::Percentiles;
use echofix_harness::process::ServiceProcess;
use serde::Serialize;
use serde_json::Value;

use super::super::BenchPlan;
use super::super::town::{BenchTown, TRUSTING};
use super::Browser;

/// The zoom at which a street fills the screen.
const ZOOM: u32 = 18;
/// Tiles that are drawn, at most.
const TILES: usize = 64;
/// What the page asks for before it shows a map.
const FIRST_DATA: [&str; 4] = ["api/v1/map", "api/v1/fixes", "api/v1/uploads", "tiles/evidence.json"];

/// What was waited for.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Town {
    /// Milliseconds for the page, its files and its first data, one after the other.
    pub(super) page_ms: f64,
    /// Kilobytes of these.
    pub(super) page_kb: f64,
    /// Files of the page, itself included.
    pub(super) files: usize,
    /// Tiles drawn.
    pub(super) tiles: usize,
    /// Milliseconds a tile, the first time.
    pub(super) tile_ms: Percentiles,
    /// The same once more.
    pub(super) tile_again_ms: Percentiles,
}

/// Maps a town and looks at it.
///
/// # Errors
/// When the service does not start, or does not answer.
pub(super) async fn measure(plan: &BenchPlan, folder: &Path) -> anyhow::Result<Town> {
    std::fs::create_dir_all(folder)?;
    BenchTown::mapped(plan, folder).await?;
    let service = ServiceProcess::start(folder, &[TRUSTING.to_owned()]).await?;
    service.folded().await?;
    let http = service.http.clone();
    let looked = tokio::task::spawn_blocking(move || look(&Browser::at(&http))).await??;
    service.stop().await?;
    Ok(looked)
}

fn look(browser: &Browser) -> anyhow::Result<Town> {
    let (page, mut page_ms) = browser.get("")?;
    let files = files(&String::from_utf8_lossy(&page));
    ensure!(!files.is_empty(), "the console was left out of this build, so that there is no page to load");
    let mut bytes = page.len();
    for path in files.iter().map(String::as_str).chain(FIRST_DATA) {
        let (body, ms) = browser.get(path)?;
        (bytes, page_ms) = (bytes + body.len(), page_ms + ms);
    }
    let description: Value = serde_json::from_slice(&browser.get("tiles/evidence.json")?.0)?;
    let tiles = tiles(&description).context("the description of the map has no bounds")?;
    let drawn = || tiles.iter().map(|path| Ok(browser.get(path)?.1)).collect::<anyhow::Result<Vec<f64>>>();
    let (first, again) = (drawn()?, drawn()?);
    let of = |ms| Percentiles::of(ms).context("no tile was drawn");
    Ok(Town {
        page_ms,
        page_kb: bytes as f64 / 1e3,
        files: files.len() + 1,
        tiles: tiles.len(),
        tile_ms: of(first)?,
        tile_again_ms: of(again)?,
    })
}

/// Scripts and styles that a page names, relative to it.
fn files(page: &str) -> Vec<String> {
    let named =
        |attribute: &'static str| page.split(attribute).skip(1).filter_map(|rest| rest.split('"').next());
    let all = named("src=\"").chain(named("href=\""));
    let own = all.filter(|path| [".js", ".css"].iter().any(|ending| path.ends_with(ending)));
    own.map(|path| path.trim_start_matches(['.', '/']).to_owned()).collect()
}

/// Paths of the tiles within the bounds of a `TileJSON`, those in the middle first.
fn tiles(description: &Value) -> Option<Vec<String>> {
    let bounds: Vec<f64> = description["bounds"].as_array()?.iter().filter_map(Value::as_f64).collect();
    let [west, south, east, north] = bounds[..] else { return None };
    let ((left, top), (right, bottom)) = (web_tile(west, north), web_tile(east, south));
    let middle = (f64::midpoint(left, right), f64::midpoint(top, bottom));
    let whole = |from: f64, to: f64| (from as u32..=to as u32).collect::<Vec<_>>();
    let mut all: Vec<(u32, u32)> =
        whole(left, right).iter().flat_map(|x| whole(top, bottom).into_iter().map(|y| (*x, y))).collect();
    all.sort_by_key(|(x, y)| {
        ((f64::from(*x) - middle.0).powi(2) + (f64::from(*y) - middle.1).powi(2)) as u64
    });
    all.truncate(TILES);
    Some(all.into_iter().map(|(x, y)| format!("tiles/evidence/{ZOOM}/{x}/{y}.png")).collect())
}

/// The tile of web maps that holds a position (Slippy map tilenames), with the fraction within it.
fn web_tile(lon_deg: f64, lat_deg: f64) -> (f64, f64) {
    let n = f64::from(1_u32 << ZOOM);
    let lat = lat_deg.to_radians();
    let y = (1.0 - (lat.tan() + 1.0 / lat.cos()).ln() / std::f64::consts::PI) / 2.0 * n;
    ((lon_deg + 180.0) / 360.0 * n, y)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a page that is measured without its files, and tiles beside the town.
    #[test]
    fn files_and_tiles_are_those_of_page_and_town() {
        let page =
            r#"<link rel="icon" href="data:,"><link href="./a-1.css"><script type="module" src="b.js">"#;
        assert_eq!(files(page), ["b.js", "a-1.css"]);
        let austin = serde_json::json!({ "bounds": [-97.7431, 30.2672, -97.7411, 30.2682] });
        let tiles = tiles(&austin).unwrap();
        assert!((2..=9).contains(&tiles.len()), "{tiles:?}");
        assert!(
            tiles.contains(&"tiles/evidence/18/59898/107960.png".to_owned()) || tiles[0].contains("/18/5989"),
            "{tiles:?}"
        );
    }
}
