//! The map in numbers, one tile in numbers.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use axum::response::Response;
use echofix_core::geo::{Grid, LatLon, TILE_M, TileId};
use serde::Deserialize;

use super::App;
use super::answers::{
    BUSY, BuildingAnswer, ErrorAnswer, MapAnswer, NO_SUCH_EPOCH, PassCount, ProgressAnswer, TileAnswer,
    TotalsAnswer, WaitingAnswer, ZoneAnswer,
};
use super::day::iso_date;
use super::error::Error;
use super::operations::fresh;
use super::past::{EpochParameter, EpochQuery, Shown};
use super::raster::corners;
use crate::shares::Peer;
use crate::store::{MapProgress, MapStatus, MapStore, StoredTile};

/// `GET /api/v1/map`
#[utoipa::path(
    get,
    path = "/api/v1/map",
    operation_id = "getMap",
    tag = "map",
    summary = "The whole map in numbers.",
    description = "",
    params(EpochQuery),
    responses(
        (status = 200, description = "The map.", body = MapAnswer),
        (status = 400, description = "Not an epoch.", body = ErrorAnswer),
        (status = 404, description = NO_SUCH_EPOCH, body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn map(State(app): State<Arc<App>>, peer: Peer, epoch: EpochParameter) -> Result<Response, Error> {
    let Shown { store, artist } = app.shown(peer, epoch).await?;
    let body = app.limiter.work(peer, move || {
        let (overview, totals) = (artist.overview()?, store.totals());
        let zones = overview.zones.iter().map(|(zone, tiles)| {
            let hemisphere = if zone.is_south() { "south" } else { "north" };
            ZoneAnswer {
                epsg: zone.epsg(),
                name: format!("UTM {} {hemisphere}", zone.number()),
                tiles: *tiles,
            }
        });
        Ok(MapAnswer {
            progress: progress_answer(&store.progress().borrow()),
            zones: zones.collect(),
            bounds: overview.bounds(),
            center: overview.center(),
            totals: TotalsAnswer {
                tiles: totals.tiles,
                cells: totals.cells,
                bytes: totals.bytes,
                uploads: totals.uploads,
                area_km2: totals.tiles as f64 * TILE_M * TILE_M / 1e6,
                newest_day: totals.newest_day,
                newest_date: (totals.tiles > 0).then(|| iso_date(totals.newest_day)),
            },
            waiting: WaitingAnswer {
                tiles: totals.waiting_tiles,
                contributors: totals.waiting_contributors,
                needed: totals.needed,
            },
        })
    });
    Ok(fresh(body.await?))
}

/// How far the map is.
pub fn progress_answer(progress: &MapProgress) -> ProgressAnswer {
    let state = match progress.state {
        MapStatus::Rebuilding => "rebuilding",
        MapStatus::Serving => "serving",
        MapStatus::Stalled => "stalled",
    };
    let building = progress.building.map(|building| BuildingAnswer {
        folded: building.folded,
        of: building.of,
        control: building.control,
    });
    ProgressAnswer { state, epoch: progress.epoch, journaled: progress.journaled, building }
}

/// `?lat=&lon=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct PositionQuery {
    /// Degrees north, WGS-84.
    lat: f64,
    /// Degrees east, WGS-84.
    lon: f64,
}

/// `GET /api/v1/tiles/at?lat=&lon=`
#[utoipa::path(
    get,
    path = "/api/v1/tiles/at",
    operation_id = "getTileAt",
    tag = "tiles",
    summary = "The tile that holds a position, in numbers.",
    description = "",
    params(PositionQuery, EpochQuery),
    responses(
        (status = 200, description = "The tile.", body = TileAnswer),
        (status = 400, description = "Not a position in UTM.", body = ErrorAnswer),
        (status = 404, description = "Nothing is served there.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn tile_at(
    State(app): State<Arc<App>>,
    peer: Peer,
    at: Result<Query<PositionQuery>, QueryRejection>,
    epoch: EpochParameter,
) -> Result<Response, Error> {
    let Query(PositionQuery { lat, lon }) = at?;
    let id = TileId::at(LatLon { lat_deg: lat, lon_deg: lon })?;
    described(&app, peer, id, epoch).await
}

/// `GET /api/v1/tiles/{epsg}/{x}/{y}`
#[utoipa::path(
    get,
    path = "/api/v1/tiles/{epsg}/{x}/{y}",
    operation_id = "getTile",
    tag = "tiles",
    summary = "One tile in numbers.",
    description = "",
    params(
        ("epsg" = u16, Path, description = "EPSG code of the UTM zone: 32601 to 32660 north, 32701 to 32760 south."),
        ("x" = i32, Path, description = "Tiles of 51.2 m east."),
        ("y" = i32, Path, description = "Tiles of 51.2 m north."),
        EpochQuery,
    ),
    responses(
        (status = 200, description = "The tile.", body = TileAnswer),
        (status = 400, description = "Not a tile's name.", body = ErrorAnswer),
        (status = 404, description = "Nothing is served there.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn tile(
    State(app): State<Arc<App>>,
    peer: Peer,
    Path((epsg, x, y)): Path<(String, String, String)>,
    epoch: EpochParameter,
) -> Result<Response, Error> {
    described(&app, peer, format!("{epsg}/{x}/{y}").parse()?, epoch).await
}

async fn described(app: &Arc<App>, peer: Peer, id: TileId, epoch: EpochParameter) -> Result<Response, Error> {
    let store = app.shown(peer, epoch).await?.store;
    Ok(fresh(app.limiter.work(peer, move || describe(&*store, id)).await?))
}

fn describe(store: &dyn MapStore, id: TileId) -> Result<TileAnswer, Error> {
    let nothing = || Error::NotFound(format!("nothing is served in tile {id}"));
    let stored = store.tile(id)?.ok_or_else(nothing)?;
    let StoredTile { version, tile, .. } = &stored;
    let corners = corners(&Grid::new(id.zone)?, [id.x, id.y], [id.x, id.y])?;
    let mut passes = BTreeMap::<u32, u32>::new();
    let (mut hits, mut oldest_day) = (0, u16::MAX);
    for (_, cell) in tile.cells() {
        *passes.entry(cell.passes).or_default() += 1;
        hits += u64::from(cell.hits);
        oldest_day = oldest_day.min(cell.first_day);
    }
    let passes = passes.into_iter().map(|(passes, cells)| PassCount { passes, cells }).collect();
    Ok(TileAnswer {
        id: id.to_string(),
        epsg: id.zone.epsg(),
        x: id.x,
        y: id.y,
        version: *version,
        cells: tile.len(),
        hits,
        passes,
        oldest_date: (!tile.is_empty()).then(|| iso_date(oldest_day)),
        newest_day: tile.newest_day(),
        newest_date: (!tile.is_empty()).then(|| iso_date(tile.newest_day())),
        bytes: stored.encoded().len(),
        corners: corners.map(|at| [at.lon_deg, at.lat_deg]),
    })
}

#[cfg(test)]
mod tests {
    use crate::http::testing::{TestSite, austin, json_of};
    use serde_json::{Value, json};

    #[tokio::test]
    async fn the_map_in_numbers() {
        let site = TestSite::with_tiles(&[(austin(), &[(0, 1), (5, 3)])]);
        let body = json_of(site.get("/api/v1/map").await).await;
        assert_eq!((&body["totals"]["tiles"], &body["totals"]["cells"]), (&json!(1), &json!(2)));
        assert_eq!(body["zones"], json!([{ "epsg": 32614, "name": "UTM 14 north", "tiles": 1 }]));
        assert!((body["totals"]["area_km2"].as_f64().unwrap() - 0.002_621_44).abs() < 1e-9);
        assert_eq!(body["bounds"].as_array().unwrap().len(), 4);
        assert_eq!(body["center"].as_array().unwrap().len(), 2);
    }

    #[tokio::test]
    async fn an_empty_map_says_null_and_not_nonsense() {
        let body = json_of(TestSite::default().get("/api/v1/map").await).await;
        assert_eq!((&body["bounds"], &body["center"]), (&Value::Null, &Value::Null));
        assert_eq!(body["totals"]["newest_date"], Value::Null);
    }

    #[tokio::test]
    async fn a_tile_is_found_by_its_name_and_by_a_position_in_it() {
        let site = TestSite::with_tiles(&[(austin(), &[(0, 1), (5, 3), (6, 3)])]);
        let by_name = json_of(site.get(&format!("/api/v1/tiles/{}", austin())).await).await;
        assert_eq!(by_name["passes"], json!([{ "passes": 1, "cells": 1 }, { "passes": 3, "cells": 2 }]));
        assert_eq!(by_name["newest_date"], "2024-10-04");
        let [west, south] = [0, 1].map(|axis| by_name["corners"][0][axis].as_f64().unwrap());
        let inside = format!("/api/v1/tiles/at?lat={}&lon={}", south + 2e-4, west + 2e-4);
        assert_eq!(json_of(site.get(&inside).await).await, by_name);
    }

    #[tokio::test]
    async fn what_is_no_tile_is_distinguished_from_an_empty_one() {
        let site = TestSite::default();
        for (path, status) in [
            ("/api/v1/tiles/32614/1/2", 404),
            ("/api/v1/tiles/4326/1/2", 400),
            ("/api/v1/tiles/32614/a/2", 400),
            ("/api/v1/tiles/at?lat=30&lon=-97", 404),
            ("/api/v1/tiles/at?lat=89&lon=0", 400),
            ("/api/v1/tiles/at?lat=NaN&lon=0", 400),
            ("/api/v1/tiles/at?lat=1e308&lon=1e308", 400),
            ("/api/v1/tiles/at?lat=1", 400),
        ] {
            let response = site.get(path).await;
            assert_eq!(response.status(), status, "{path}");
            assert!(json_of(response).await["error"]["message"].is_string());
        }
    }
}
