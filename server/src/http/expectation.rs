//! What fixes in a tile can be expected to be.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Response;
use echofix_core::align::localizability::Localizability;
use echofix_core::geo::{Grid, TILE_M, TileId};
use echofix_core::pose::{Pose2, wrap_axis};

use super::App;
use super::answers::{BUSY, ErrorAnswer, ExpectedFixAnswer, LocalizabilityAnswer};
use super::error::Error;
use super::operations::fresh;
use crate::locating::{Expectations, SPOTS_PER_SIDE, expected_word};
use crate::patience::Patience;
use crate::shares::Peer;

/// `GET /api/v1/tiles/{epsg}/{x}/{y}/localizability`
#[utoipa::path(
    get,
    path = "/api/v1/tiles/{epsg}/{x}/{y}/localizability",
    operation_id = "getLocalizability",
    tag = "tiles",
    summary = "What fixes in a tile can be expected to be, by the map alone.",
    description = "",
    params(
        ("epsg" = u16, Path, description = "EPSG code of the UTM zone: 32601 to 32660 north, 32701 to 32760 south."),
        ("x" = i32, Path, description = "Tiles of 51.2 m east."),
        ("y" = i32, Path, description = "Tiles of 51.2 m north."),
    ),
    responses(
        (status = 200, description = "The expectations.", body = LocalizabilityAnswer),
        (status = 400, description = "Not a tile's name.", body = ErrorAnswer),
        (status = 404, description = "Nothing is served there and around it.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn tile(
    State(app): State<Arc<App>>,
    peer: Peer,
    Path((epsg, x, y)): Path<(String, String, String)>,
) -> Result<Response, Error> {
    let id: TileId = format!("{epsg}/{x}/{y}").parse()?;
    let expectations = Arc::clone(&app.state.expectations);
    let body = app.limiter.attended(peer, move |patience| describe(&expectations, id, patience)).await?;
    Ok(fresh(body))
}

fn describe(
    expectations: &Expectations,
    id: TileId,
    patience: &Patience,
) -> Result<LocalizabilityAnswer, Error> {
    let nothing = || Error::NotFound(format!("nothing is served in tile {id} and around it"));
    let tile = expectations.tile(id, patience)?.ok_or_else(nothing)?;
    let grid = Grid::new(id.zone)?;
    let spots = tile.spots().map(|(column, row, expected)| {
        let middle = [column, row].map(|step| (step as f64 + 0.5) * TILE_M / SPOTS_PER_SIDE as f64);
        let at = id.origin().moved(middle[0], middle[1]);
        let pose = Pose2::new(at.x_m, at.y_m, expected.weak_direction_rad());
        let (at, direction_rad) = grid.pose_to_geodetic(&pose)?;
        Ok(ExpectedFixAnswer {
            longitude_deg: at.lon_deg,
            latitude_deg: at.lat_deg,
            expected: expected_word(expectations.verdict(expected)),
            points: expected.points,
            weakest_sigma_m: expected.weakest_m(),
            weakest_direction_rad: wrap_axis(direction_rad),
            strongest_sigma_m: expected.strongest_m(),
            sigma_yaw_rad: expected.sigma_yaw_rad(),
            margin: finite(expected),
            rival_m: expected.rival.map(|rival| [rival.x_m, rival.y_m]),
        })
    });
    let places = spots.collect::<Result<_, Error>>()?;
    Ok(LocalizabilityAnswer { id: id.to_string(), version: tile.version, places })
}

/// The margin; JSON knows no infinity, which stands for no rival.
fn finite(expected: &Localizability) -> Option<f64> {
    Some(expected.margin).filter(|margin| margin.is_finite())
}

#[cfg(test)]
mod tests {
    use crate::http::testing::{TestSite, austin, json_of};
    use echofix_core::geo::TileId;
    use serde_json::json;
    use std::sync::atomic::Ordering;

    /// Catches what is computed anew although the map has not changed, or cached although it has.
    #[tokio::test]
    async fn a_tile_is_assessed_once_a_version() {
        let cells: Vec<(u32, u32)> = (0..40).map(|k| (k * 6007 % (512 * 512), 1)).collect();
        let site = TestSite::with_tiles(&[(austin(), &cells)]);
        let path = format!("/api/v1/tiles/{}/localizability", austin());
        let first = json_of(site.get(&path).await).await;
        assert_eq!((&first["version"], first["places"].as_array().unwrap().len()), (&json!(1), 4));
        let place = &first["places"][0];
        assert_eq!(
            (&place["expected"], place["points"].as_u64() > Some(0)),
            (&json!("TOO_LITTLE_STRUCTURE"), true)
        );
        let reads = site.store.reads.load(Ordering::Relaxed);
        assert_eq!(json_of(site.get(&path).await).await, first);
        assert_eq!(site.store.reads.load(Ordering::Relaxed), reads, "the second answer was known");
        site.store.touch(austin());
        let touched = json_of(site.get(&path).await).await;
        assert_eq!((&touched["version"], &touched["places"]), (&json!(2), &first["places"]));
        assert!(site.store.reads.load(Ordering::Relaxed) > reads);
    }

    #[tokio::test]
    async fn an_empty_tile_beside_a_mapped_one_has_expectations_and_a_far_one_has_none() {
        let site = TestSite::with_tiles(&[(austin(), &[(7, 5)])]);
        for (x, status) in [(austin().x + 1, 200), (austin().x + 2, 404)] {
            let id = TileId { x, ..austin() };
            assert_eq!(
                site.get(&format!("/api/v1/tiles/{id}/localizability")).await.status(),
                status,
                "{id}"
            );
        }
        assert_eq!(site.get("/api/v1/tiles/4326/1/2/localizability").await.status(), 400);
    }
}
