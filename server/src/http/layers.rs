//! Map tiles and their `TileJSON`.

use std::sync::Arc;

use axum::extract::{Extension, Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::App;
use super::answers::{BUSY, ErrorAnswer, TileJsonAnswer};
use super::error::Error;
use super::outside::Outside;
use super::past::{EpochParameter, EpochQuery};
use super::raster::{Artist, Layer, MAX_ZOOM, View, legend};
use crate::shares::Peer;

/// The whole of Web Mercator, for a map that is empty.
const WORLD: [f64; 4] = [-180.0, -85.051_129, 180.0, 85.051_129];

/// `GET /tiles/{layer}/{z}/{x}/{y}.png`, also `{y}@2x.png`
#[utoipa::path(
    get,
    path = "/tiles/{layer}/{z}/{x}/{y}.png",
    operation_id = "getPicture",
    tag = "tiles",
    summary = "A map tile, Web Mercator XYZ, 256 pixels wide (512 as {y}@2x.png); transparent where nothing is known.",
    description = "",
    params(
        ("layer" = String, Path, description = "What to draw.", pattern = "^(evidence|coverage|age|localizability)$", example = "evidence"),
        ("z" = u8, Path, description = "Zoom.", minimum = 0, maximum = 22),
        ("x" = u32, Path, description = "Tiles east."),
        ("y" = String, Path, description = "Tiles south; `@2x` may follow.", pattern = "^[0-9]+(@2x)?$"),
        ("if-none-match" = Option<String>, Header, description = "Tags of the pictures at hand."),
        EpochQuery,
    ),
    responses(
        (status = 200, description = "The picture.", body = Vec<u8>, content_type = "image/png", headers(("etag" = String, description = "Names the picture."))),
        (status = 304, description = "The picture at hand is still right."),
        (status = 400, description = "Not an address of a tile.", body = ErrorAnswer),
        (status = 404, description = "No such layer, or no such epoch.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn tile(
    State(app): State<Arc<App>>,
    peer: Peer,
    Path((layer, z, x, file)): Path<(String, String, String, String)>,
    epoch: EpochParameter,
    headers: HeaderMap,
) -> Result<Response, Error> {
    let layer: Layer = layer.parse()?;
    let view = View::parse(&z, &x, &file)?;
    let artist: Arc<Artist> = app.shown(peer, epoch).await?.artist;
    let draw = move |patience: &_| artist.draw(layer, view, |tag| is_known(&headers, tag), patience);
    let answer = app.limiter.attended(peer, draw).await?;
    let headers = [(header::ETAG, answer.tag), (header::CACHE_CONTROL, "no-cache".to_owned())];
    Ok(match answer.png {
        Some(png) => (headers, [(header::CONTENT_TYPE, "image/png")], png).into_response(),
        None => (StatusCode::NOT_MODIFIED, headers).into_response(),
    })
}

/// Whether the client's `If-None-Match` names this tag.
fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let given = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    given.flat_map(|list| list.split(',')).map(str::trim).any(|one| {
        // A weak comparison, as RFC 9110, 13.1.2 asks for.
        one == "*" || one.strip_prefix("W/").unwrap_or(one) == tag
    })
}

/// `GET /tiles/{layer}.json`
#[utoipa::path(
    get,
    path = "/tiles/{layer}.json",
    operation_id = "getLayer",
    tag = "tiles",
    summary = "TileJSON 3.0 of a layer.",
    description = "",
    params(
        ("layer" = String, Path, description = "What to draw.", pattern = "^(evidence|coverage|age|localizability)$", example = "evidence"),
        EpochQuery,
    ),
    responses(
        (status = 200, description = "The layer.", body = TileJsonAnswer),
        (status = 400, description = "Not an epoch.", body = ErrorAnswer),
        (status = 404, description = "No such layer, or no such epoch.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn tilejson(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(outside): Extension<Outside>,
    Path(file): Path<String>,
    epoch: EpochParameter,
) -> Result<Response, Error> {
    let expected =
        || Error::NotFound(format!("`{file}` is not a layer's description; expected <layer>.json"));
    let layer: Layer = file.strip_suffix(".json").ok_or_else(expected)?.parse()?;
    let of_epoch = epoch.query().unwrap_or_default();
    let artist = app.shown(peer, epoch).await?.artist;
    let overview = app.limiter.work(peer, move || artist.overview()).await?;
    let body = TileJsonAnswer {
        tilejson: "3.0.0",
        name: format!("Echofix {layer}"),
        description: layer.description(),
        version: format!("1.0.{}", overview.epoch),
        scheme: "xyz",
        tiles: [format!("{}/tiles/{layer}/{{z}}/{{x}}/{{y}}.png{of_epoch}", outside.address())],
        minzoom: layer.min_zoom(),
        maxzoom: MAX_ZOOM,
        bounds: overview.bounds().map_or(WORLD, in_one_world),
        center: overview.center().map(|[lon, lat]| (lon, lat, 16)),
        attribution: "Echofix radar map",
        vector_layers: [],
        legend: legend(layer),
    };
    Ok(([(header::CACHE_CONTROL, "no-cache")], axum::Json(body)).into_response())
}

/// Bounds as readers of `TileJSON` take them, who know no box across the date line: all around the globe then.
fn in_one_world([west, south, east, north]: [f64; 4]) -> [f64; 4] {
    if west <= east { [west, south, east, north] } else { [-180.0, south, 180.0, north] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::{TestSite, austin, json_of, pixels_of};
    use axum::http::Method;
    use echofix_core::geo::{CELL_M, Grid, LatLon, TileId, Zone};
    use serde_json::json;
    use std::sync::atomic::Ordering;

    /// The map tile at a zoom that shows a cell of the Austin tile, and the pixel of its centre.
    fn tile_and_pixel(z: u8, cell: u32) -> (String, [usize; 2]) {
        let id = austin();
        let (column, row) = (f64::from(cell % 512), f64::from(cell / 512));
        let centre = id.origin().moved((column + 0.5) * CELL_M, (row + 0.5) * CELL_M);
        let at = Grid::new(id.zone).unwrap().unproject(centre).unwrap();
        // The textbook formula, written out here on its own.
        let n = f64::from(1_u32 << z);
        let lat = at.lat_deg.to_radians();
        let x = (at.lon_deg + 180.0) / 360.0 * n;
        let y = (1.0 - (lat.tan() + 1.0 / lat.cos()).ln() / std::f64::consts::PI) / 2.0 * n;
        let pixel = [x, y].map(|v| (v.fract() * 256.0) as usize);
        (format!("{z}/{}/{}", x as u32, y as u32), pixel)
    }

    #[tokio::test]
    async fn a_known_cell_is_drawn_at_its_pixel() {
        let cell = 300 * 512 + 200;
        let site = TestSite::with_tiles(&[(austin(), &[(cell, 5)])]);
        for z in 0..=22 {
            let (path, [px, py]) = tile_and_pixel(z, cell);
            for layer in ["evidence", "coverage", "age"] {
                let pixels = pixels_of(site.get(&format!("/tiles/{layer}/{path}.png")).await).await;
                assert!(pixels[py * 256 + px][3] > 0, "{layer} at zoom {z}");
                let drawn = pixels.iter().filter(|p| p[3] > 0).count();
                let most = if z >= 14 && layer != "coverage" { 25 } else { 256 * 256 };
                assert!((1..=most).contains(&drawn), "{drawn} pixels of {layer} at zoom {z}");
            }
        }
    }

    #[tokio::test]
    async fn a_cell_is_as_wide_as_its_ground_at_the_deepest_zoom() {
        let cell = 300 * 512 + 200;
        let site = TestSite::with_tiles(&[(austin(), &[(cell, 5)])]);
        let (path, _) = tile_and_pixel(22, cell);
        let pixels = pixels_of(site.get(&format!("/tiles/evidence/{path}.png")).await).await;
        let drawn = pixels.iter().filter(|p| p[3] > 0).count() as f64;
        // 0.1 m over 0.0373 m * cos(30.27 deg) of a pixel is 3.10 pixels.
        assert!((drawn.sqrt() - 3.1).abs() < 0.4, "{drawn}");
    }

    #[tokio::test]
    async fn dense_screens_get_twice_the_pixels() {
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)])]);
        let (path, [px, py]) = tile_and_pixel(19, 7);
        let pixels = pixels_of(site.get(&format!("/tiles/evidence/{path}@2x.png")).await).await;
        assert_eq!(pixels.len(), 512 * 512);
        let around = |i: usize| (2 * i).saturating_sub(1)..=2 * i + 2;
        assert!(around(py).any(|y| around(px).any(|x| pixels[(y * 512 + x).min(pixels.len() - 1)][3] > 0)));
    }

    #[tokio::test]
    async fn an_unchanged_tile_is_not_sent_again() {
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)])]);
        for z in [3, 12, 19] {
            let path = format!("/tiles/evidence/{}.png", tile_and_pixel(z, 7).0);
            let first = site.get(&path).await;
            assert_eq!(
                (first.status(), &first.headers()["cache-control"]),
                (StatusCode::OK, &"no-cache".parse().unwrap())
            );
            let tag = first.headers()["etag"].to_str().unwrap().to_owned();
            let weak = format!("\"other\", W/{tag}");
            let again = site.send(Method::GET, &path, &[("if-none-match", &weak)]).await;
            assert_eq!(again.status(), StatusCode::NOT_MODIFIED);
            assert_eq!(again.headers()["etag"], tag);
            let other_layer = site.get(&path.replace("evidence", "age")).await;
            assert_ne!(other_layer.headers()["etag"], tag);
            site.store.touch(austin());
            tokio::time::sleep(std::time::Duration::from_millis(if z == 3 { 1050 } else { 0 })).await;
            let changed = site.send(Method::GET, &path, &[("if-none-match", &tag)]).await;
            assert_eq!(changed.status(), StatusCode::OK, "zoom {z}");
        }
    }

    /// Breaks it: naming pictures by the versions of tiles alone, which a restored backup gives to others.
    #[tokio::test]
    async fn a_restored_map_is_sent_again() {
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)])]);
        let path = format!("/tiles/evidence/{}.png", tile_and_pixel(19, 7).0);
        let tag = site.get(&path).await.headers()["etag"].to_str().unwrap().to_owned();
        site.store.lineage.fetch_add(1, Ordering::Relaxed);
        let restored = site.send(Method::GET, &path, &[("if-none-match", &tag)]).await;
        assert_eq!(restored.status(), StatusCode::OK);
    }

    /// Breaks it: naming pictures by the versions of their tiles alone, which do not know that another tile's later day lets them fade.
    #[tokio::test]
    async fn pictures_follow_the_newest_day_of_the_map() {
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)])]);
        let paths: Vec<_> = ["evidence", "coverage", "age", "localizability"]
            .map(|layer| format!("/tiles/{layer}/{}.png", tile_and_pixel(18, 7).0))
            .into();
        let tag = async |path: &String| site.get(path).await.headers()["etag"].to_str().unwrap().to_owned();
        let mut before = Vec::new();
        for path in &paths {
            before.push(tag(path).await);
            assert_eq!(tag(path).await, before[before.len() - 1], "{path}");
        }
        let far = TileId { x: austin().x + 100, ..austin() };
        let later = echofix_core::evidence::Cell {
            hits: 2,
            passes: 1,
            contributors: 1,
            last_day: 60_000,
            ..Default::default()
        };
        site.store.put(far, echofix_core::tile::Tile::from_cells(vec![(7, later)]).unwrap());
        for (path, before) in paths.iter().zip(before) {
            assert_ne!(tag(path).await, before, "{path}");
        }
    }

    #[tokio::test]
    async fn no_far_view_decodes_tiles_and_no_near_one_twice() {
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)])]);
        let reads = || site.store.reads.load(Ordering::Relaxed);
        for z in 0..14 {
            pixels_of(site.get(&format!("/tiles/evidence/{}.png", tile_and_pixel(z, 7).0)).await).await;
        }
        assert_eq!(reads(), 0);
        for layer in ["evidence", "age", "evidence"] {
            pixels_of(site.get(&format!("/tiles/{layer}/{}.png", tile_and_pixel(15, 7).0)).await).await;
        }
        assert_eq!(reads(), 1);
    }

    #[tokio::test]
    async fn what_is_expected_of_fixes_is_drawn_near_and_follows_the_neighbours() {
        let beside = TileId { x: austin().x + 1, ..austin() };
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)]), (beside, &[(9, 1)])]);
        let far =
            pixels_of(site.get(&format!("/tiles/localizability/{}.png", tile_and_pixel(15, 7).0)).await)
                .await;
        assert!(far.iter().all(|p| p[3] == 0), "from far away it would take too long");
        let (path, [px, py]) = tile_and_pixel(18, 7);
        let path = format!("/tiles/localizability/{path}.png");
        let first = site.get(&path).await;
        let tag = first.headers()["etag"].to_str().unwrap().to_owned();
        // Two cells are no structure: the warm end of the ramp.
        let [red, _, blue, opacity] = pixels_of(first).await[py * 256 + px];
        assert!(opacity > 0 && red > blue);
        let again = site.send(Method::GET, &path, &[("if-none-match", &tag)]).await;
        assert_eq!(again.status(), StatusCode::NOT_MODIFIED);
        site.store.touch(beside);
        let changed = site.send(Method::GET, &path, &[("if-none-match", &tag)]).await;
        assert_eq!(changed.status(), StatusCode::OK, "the neighbour is within reach");
        let body = json_of(site.get("/tiles/localizability.json").await).await;
        assert_eq!((&body["minzoom"], &body["legend"][1]["label"]), (&json!(16), &json!("ambiguous")));
    }

    #[tokio::test]
    async fn a_pixel_is_drawn_from_the_zone_it_belongs_to() {
        // Near the border at 6 degrees east the map keeps both zones on both sides.
        let tile = |epsg, lon_deg| {
            let grid = Grid::new(Zone::from_epsg(epsg).unwrap()).unwrap();
            TileId::of(grid.zone(), grid.project(LatLon { lat_deg: 51.0, lon_deg }).unwrap())
        };
        let full: Vec<(u32, u32)> = (0..512 * 512).map(|index| (index, 5)).collect();
        let drawn = async |tiles: &[TileId]| {
            let tiles: Vec<_> = tiles.iter().map(|id| (*id, full.as_slice())).collect();
            let n = f64::from(1 << 17);
            let x = (6.0_f64 + 180.0) / 360.0 * n;
            let y = (1.0 - 51_f64.to_radians().tan().asinh() / std::f64::consts::PI) / 2.0 * n;
            let path = format!("/tiles/evidence/17/{}/{}.png", x as u32, y as u32);
            let pixels = pixels_of(TestSite::with_tiles(&tiles).get(&path).await).await;
            // 6 degrees east is x = 67720.53 at this zoom: the border lies within the picture.
            let border = (x.fract() * 256.0).round() as usize;
            let count = |west: bool| {
                pixels.iter().enumerate().filter(|(i, p)| p[3] > 0 && (i % 256 < border) == west).count()
            };
            (count(true), count(false))
        };
        assert_eq!(drawn(&[tile(32631, 6.0004)]).await.1, 0, "zone 31 ends at the border");
        assert_eq!(drawn(&[tile(32632, 5.9996)]).await.0, 0, "zone 32 begins at the border");
        assert!(drawn(&[tile(32632, 6.0004)]).await.1 > 500);
        assert!(drawn(&[tile(32631, 5.9996)]).await.0 > 500);
    }

    #[tokio::test]
    async fn a_map_that_is_not_whole_is_not_shown() {
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)])]);
        site.store.rebuild();
        for z in [5, 12, 18] {
            let response = site.get(&format!("/tiles/evidence/{}.png", tile_and_pixel(z, 7).0)).await;
            assert_eq!(
                (response.status().as_u16(), &response.headers()["retry-after"]),
                (503, &"1".parse().unwrap())
            );
            assert_eq!(json_of(response).await["error"]["code"], "rebuilding");
        }
    }

    #[tokio::test]
    async fn an_empty_tile_is_a_transparent_picture() {
        let site = TestSite::default();
        for z in [0, 11, 20] {
            let pixels = pixels_of(site.get(&format!("/tiles/evidence/{z}/0/0.png")).await).await;
            assert!(pixels.iter().all(|p| p[3] == 0));
        }
    }

    #[tokio::test]
    async fn bad_addresses_say_what_is_expected() {
        let site = TestSite::default();
        for (path, status, hint) in [
            ("/tiles/roads/0/0/0.png", 404, "evidence, coverage, age or localizability"),
            ("/tiles/evidence/23/0/0.png", 400, "z from 0 to 22"),
            ("/tiles/evidence/1/2/0.png", 400, "2^z - 1"),
            ("/tiles/evidence/1/0/0.jpg", 400, "y.png"),
            ("/tiles/evidence", 404, "<layer>.json"),
            ("/tiles/roads.json", 404, "evidence, coverage, age or localizability"),
        ] {
            let response = site.get(path).await;
            assert_eq!(response.status(), status, "{path}");
            let body = json_of(response).await;
            let message = body["error"]["message"].as_str().unwrap();
            assert!(message.contains(hint), "{path}: {message}");
        }
    }

    #[tokio::test]
    async fn tilejson_tells_where_and_what() {
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)])]);
        let body =
            json_of(site.send(Method::GET, "/tiles/age.json", &[("host", "map.example:8080")]).await).await;
        assert_eq!(body["tilejson"], "3.0.0");
        assert_eq!(body["tiles"][0], "http://map.example:8080/tiles/age/{z}/{x}/{y}.png");
        assert_eq!((&body["minzoom"], &body["maxzoom"]), (&json!(0), &json!(22)));
        let bounds: Vec<f64> =
            body["bounds"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert!(
            bounds[0] < bounds[2] && bounds[1] < bounds[3] && (bounds[1] - 30.26).abs() < 0.1,
            "{bounds:?}"
        );
        assert_eq!(body["legend"][0]["label"], "today");
        for (headers, origin) in [
            (
                &[
                    ("host", "10.0.0.1"),
                    ("x-forwarded-proto", "https, http"),
                    ("x-forwarded-host", "maps.example, inner"),
                ][..],
                "https://maps.example",
            ),
            (
                &[
                    ("host", "10.0.0.1"),
                    (
                        "forwarded",
                        "for=1.2.3.4;Proto=https;host=\"maps.example:8443\", for=5.6.7.8;proto=http",
                    ),
                ],
                "https://maps.example:8443",
            ),
            (&[("host", "maps.example"), ("x-forwarded-prefix", "/radar/")], "http://maps.example/radar"),
            (
                &[
                    ("host", "maps.example"),
                    ("x-forwarded-proto", "javascript"),
                    ("x-forwarded-host", "a\"b"),
                ],
                "http://maps.example",
            ),
        ] {
            let body = json_of(site.send(Method::GET, "/tiles/age.json", headers).await).await;
            assert_eq!(body["tiles"][0], format!("{origin}/tiles/age/{{z}}/{{x}}/{{y}}.png"));
        }
        let spoofed = site.send(Method::GET, "/tiles/age.json", &[("host", "a\"b")]).await;
        assert_eq!(json_of(spoofed).await["tiles"][0], "/tiles/age/{z}/{x}/{y}.png");
    }
}
