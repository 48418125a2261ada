//! Tiles to the cell: what is known of each, and why it is served or not.
//!
//! Viewers are told of what is served. What is not yet says where single contributors drove, and who contributed says more:
//! both are for operators.

use std::sync::Arc;

use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Path, Query, State};
use axum::response::Response;
use echofix_core::evidence::{Cell, presence, support_block, view_block};
use echofix_core::geo::{CELL_M, CELLS_PER_TILE, CellIndex, Grid, LatLon, TileId};
use echofix_core::point::MapPoint;
use echofix_core::tile::Standing;
use serde::Deserialize;

use super::App;
use super::answers::{BUSY, CellAnswer, CellAtAnswer, CellsAnswer, ErrorAnswer};
use super::contributor::hash_word;
use super::day::iso_date;
use super::error::Error;
use super::operations::fresh;
use super::past::{EpochParameter, EpochQuery};
use crate::identity::{Caller, Role};
use crate::shares::Peer;
use crate::store::{InspectedTile, MapStore};

/// Cells that are listed at once, at most, and without a limit.
const MAX_CELLS: usize = 20_000;
const USUAL_CELLS: usize = 5_000;
/// How far from a position a cell may be sought, metres.
const MAX_WITHIN_M: f64 = 5.0;

const WHO_SEES_WHAT: &str =
    "Viewers are told of the cells that are served; operators of all, and why each is served or not.";
const NOTHING_TO_TELL: &str = "Nothing that the caller may be told lies there, or there is no such epoch.";

/// `?after=&limit=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct CellsQuery {
    /// Only cells of a greater index.
    after: Option<u32>,
    /// How many cells.
    #[param(minimum = 1, maximum = 20000, default = 5000)]
    limit: Option<usize>,
}

/// `GET /api/v1/tiles/{epsg}/{x}/{y}/cells?after=&limit=&epoch=`
#[utoipa::path(
    get,
    path = "/api/v1/tiles/{epsg}/{x}/{y}/cells",
    operation_id = "getCells",
    tag = "tiles",
    summary = "The cells of a tile.",
    description = WHO_SEES_WHAT,
    params(
        ("epsg" = u16, Path, description = "EPSG code of the UTM zone: 32601 to 32660 north, 32701 to 32760 south."),
        ("x" = i32, Path, description = "Tiles of 51.2 m east."),
        ("y" = i32, Path, description = "Tiles of 51.2 m north."),
        CellsQuery,
        EpochQuery,
    ),
    responses(
        (status = 200, description = "The cells.", body = CellsAnswer),
        (status = 400, description = "Not a tile's name, or a bad parameter.", body = ErrorAnswer),
        (status = 404, description = NOTHING_TO_TELL, body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn cells(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    Path((epsg, x, y)): Path<(String, String, String)>,
    query: Result<Query<CellsQuery>, QueryRejection>,
    epoch: EpochParameter,
) -> Result<Response, Error> {
    let id: TileId = format!("{epsg}/{x}/{y}").parse()?;
    let CellsQuery { after, limit } = query?.0;
    let limit = limit.unwrap_or(USUAL_CELLS);
    if !(1..=MAX_CELLS).contains(&limit) {
        return Err(Error::BadRequest(format!("limit must lie within 1 and {MAX_CELLS}")));
    }
    let store = app.shown(peer, epoch).await?.store;
    let all = caller.may(Role::Operator);
    let listed = app.limiter.work(peer, move || {
        let place = Inspected::of(&*store, id, all)?;
        let beyond = place.cells().filter(|(index, _)| after.is_none_or(|after| *index > after));
        let mut cells: Vec<_> = beyond.take(limit + 1).copied().collect();
        let more = cells.len() > limit;
        cells.truncate(limit);
        let next_after = cells.last().filter(|_| more).map(|(index, _)| *index);
        let cells = cells.iter().map(|cell| place.told(cell, false)).collect::<Result<_, Error>>()?;
        Ok(CellsAnswer {
            tile: id.to_string(),
            version: place.version(),
            needed: place.needed(),
            cells,
            next_after,
        })
    });
    Ok(fresh(listed.await?))
}

/// `?lat=&lon=&within_m=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct CellAtQuery {
    /// Degrees north, WGS-84.
    lat: f64,
    /// Degrees east, WGS-84.
    lon: f64,
    /// How far from the position a cell of its tile is sought, metres.
    #[param(minimum = 0.0, maximum = 5.0, default = 0.0, required = false)]
    #[serde(default)]
    within_m: f64,
}

/// `GET /api/v1/cells/at?lat=&lon=&within_m=&epoch=`: the cell that was hit at a position, or else nearest to it
#[utoipa::path(
    get,
    path = "/api/v1/cells/at",
    operation_id = "getCellAt",
    tag = "tiles",
    summary = "The cell that was hit at a position, or else the nearest one.",
    description = WHO_SEES_WHAT,
    params(CellAtQuery, EpochQuery),
    responses(
        (status = 200, description = "The tile, and the cell where there is one.", body = CellAtAnswer),
        (status = 400, description = "Not a position in UTM, or a bad parameter.", body = ErrorAnswer),
        (status = 404, description = NOTHING_TO_TELL, body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn cell_at(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    query: Result<Query<CellAtQuery>, QueryRejection>,
    epoch: EpochParameter,
) -> Result<Response, Error> {
    let CellAtQuery { lat, lon, within_m } = query?.0;
    if !(0.0..=MAX_WITHIN_M).contains(&within_m) {
        return Err(Error::BadRequest(format!("within_m must lie within 0 and {MAX_WITHIN_M}")));
    }
    let grid = Grid::of(LatLon { lat_deg: lat, lon_deg: lon })?;
    let at = grid.project(LatLon { lat_deg: lat, lon_deg: lon })?;
    let id = TileId::of(grid.zone(), at);
    let store = app.shown(peer, epoch).await?.store;
    let all = caller.may(Role::Operator);
    let found = app.limiter.work(peer, move || {
        let place = Inspected::of(&*store, id, all)?;
        let far = |index: u32| middle(id, index).distance_m(at);
        let holds = |index: u32| TileId::locate(id.zone, CellIndex::of(at)) == (id, index);
        let near = place.cells().filter(|(index, _)| holds(*index) || far(*index) <= within_m);
        let nearest = near.min_by(|a, b| far(a.0).total_cmp(&far(b.0)));
        let cell = nearest.map(|cell| place.told(cell, all)).transpose()?;
        let distance_m = nearest.map(|(index, _)| far(*index));
        Ok(CellAtAnswer {
            tile: id.to_string(),
            version: place.version(),
            needed: place.needed(),
            distance_m,
            cell,
        })
    });
    Ok(fresh(found.await?))
}

/// A tile that somebody may see all of, or what is served of it.
struct Inspected {
    id: TileId,
    grid: Grid,
    known: InspectedTile,
    all: bool,
}

impl Inspected {
    fn of(store: &dyn MapStore, id: TileId, all: bool) -> Result<Self, Error> {
        let known = store.inspect(id)?;
        let place = known
            .map(|known| Ok::<_, Error>(Self { id, grid: Grid::new(id.zone)?, known, all }))
            .transpose()?;
        // Who sees only what is served is not told that somebody drove there.
        let place = place.filter(|place| place.cells().next().is_some());
        place.ok_or_else(|| {
            Error::NotFound(format!("nothing is {} in tile {id}", if all { "known" } else { "served" }))
        })
    }

    fn version(&self) -> u64 {
        self.known.version
    }

    fn needed(&self) -> u8 {
        self.known.needed
    }

    fn standing(&self, (index, cell): &(u32, Cell)) -> Standing {
        self.known.standing((*index, cell))
    }

    fn cells(&self) -> impl Iterator<Item = &(u32, Cell)> {
        let shown = |cell: &&(u32, Cell)| self.all || self.standing(cell) == Standing::Served;
        self.known.tile.cells().iter().filter(shown)
    }

    fn told(&self, (index, cell): &(u32, Cell), hashes: bool) -> Result<CellAnswer, Error> {
        let side = CELLS_PER_TILE as u32;
        let at = self.grid.unproject(middle(self.id, *index))?;
        let standing = self.standing(&(*index, *cell));
        let (support, observed) = (
            self.known.tile.support()[support_block(*index)],
            self.known.tile.observed()[view_block(*index)],
        );
        let who = || self.known.ledger.contributors_of(*index).into_iter().map(hash_word).collect();
        Ok(CellAnswer {
            index: *index,
            column: index % side,
            row: index / side,
            latitude_deg: at.lat_deg,
            longitude_deg: at.lon_deg,
            hits: cell.hits,
            passes: cell.passes,
            observed,
            contributors: cell.contributors,
            support,
            presence: presence::fraction(cell.presence),
            first_date: iso_date(cell.first_day),
            last_date: iso_date(cell.last_day),
            standing: standing_word(standing),
            reason: reason(standing, &self.known, (support, observed, cell)),
            contributor_hashes: hashes.then(who),
        })
    }
}

/// The middle of a tile's cell.
fn middle(id: TileId, index: u32) -> MapPoint {
    let side = CELLS_PER_TILE as u32;
    let metres = |cells: u32| (f64::from(cells) + 0.5) * CELL_M;
    id.origin().moved(metres(index % side), metres(index / side))
}

fn standing_word(standing: Standing) -> &'static str {
    match standing {
        Standing::Served => "SERVED",
        Standing::TooFewContributors => "TOO_FEW_CONTRIBUTORS",
        Standing::HitByTooFew => "HIT_BY_TOO_FEW",
        Standing::Expired => "EXPIRED",
        Standing::Faded => "FADED",
    }
}

fn reason(standing: Standing, known: &InspectedTile, (support, observed, cell): (u8, u16, &Cell)) -> String {
    let by = |contributors: u8| match contributors {
        1 => "1 contributor".to_owned(),
        many => format!("{many} contributors"),
    };
    let needed = known.needed;
    match standing {
        Standing::Served => {
            format!("seen by {}, {needed} {} needed", by(support), if needed == 1 { "is" } else { "are" })
        }
        Standing::TooFewContributors => format!("seen by {}, {needed} are needed", by(support)),
        Standing::HitByTooFew => {
            format!(
                "{observed} passes had it in view, and {} hit it; 2 are needed there",
                by(cell.contributors)
            )
        }
        Standing::Expired => format!("not confirmed for more than {} days", known.decay.expire_days),
        Standing::Faded => "not confirmed for so long that nothing is left of its presence".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use crate::http::testing::{StoredSite, austin, gate_of, json_of, uploads_of};
    use crate::identity::Gate;
    use crate::store::Policy;
    use serde_json::{Value, json};

    const NEEDED: u8 = 3;

    /// Three have seen cell 5, one of them cell 300 far away, too.
    async fn site(gate: Gate) -> StoredSite {
        let policy = Policy { publish_contributors: NEEDED, ..Policy::trusting() };
        StoredSite::of(uploads_of(&[(7, &[5, 300]), (8, &[5]), (9, &[5])]), policy, gate).await
    }

    async fn cells(site: &StoredSite, query: &str) -> Value {
        json_of(site.get(&format!("/api/v1/tiles/{}/cells{query}", austin())).await).await
    }

    fn at(cell: &Value) -> String {
        format!("/api/v1/cells/at?lat={}&lon={}", cell["latitude_deg"], cell["longitude_deg"])
    }

    /// Catches: cells that are listed twice or left out between pages, a reason that is not the cell's, a cell that is not found
    /// where it lies or near it, one that is told without who hit it, an epoch that is not heeded, and bad input that is taken.
    #[tokio::test]
    async fn a_tile_is_told_to_the_cell() {
        let site = site(Gate::open()).await;
        let whole = cells(&site, "").await;
        assert_eq!((&whole["needed"], whole.get("next_after")), (&json!(NEEDED), None));
        let [served, waits] = whole["cells"].as_array().unwrap().as_slice() else { panic!("{whole}") };
        for (field, value) in [
            ("index", json!(5)),
            ("column", json!(5)),
            ("row", json!(0)),
            ("hits", json!(6)),
            ("passes", json!(3)),
            ("observed", json!(3)),
            ("contributors", json!(3)),
            ("support", json!(3)),
            ("first_date", json!("2024-10-11")),
            ("last_date", json!("2024-10-13")),
            ("standing", json!("SERVED")),
            ("reason", json!("seen by 3 contributors, 3 are needed")),
        ] {
            assert_eq!(served[field], value, "{field}");
        }
        assert_eq!(waits["standing"], "TOO_FEW_CONTRIBUTORS");
        assert_eq!(waits["reason"], "seen by 1 contributor, 3 are needed");
        let first = cells(&site, "?limit=1").await;
        assert_eq!((&first["cells"], &first["next_after"]), (&json!([served]), &json!(5)));
        let next = cells(&site, "?limit=1&after=5").await;
        assert_eq!((&next["cells"], next.get("next_after")), (&json!([waits]), None));

        let found = json_of(site.get(&at(served)).await).await;
        assert_eq!((&found["tile"], &found["cell"]["index"]), (&json!(austin().to_string()), &json!(5)));
        assert!(found["distance_m"].as_f64().unwrap() < 0.01, "{found}");
        let hashes = ["0000000000000007", "0000000000000008", "0000000000000009"];
        assert_eq!(found["cell"]["contributor_hashes"], json!(hashes));
        // A metre north.
        let beside = served["latitude_deg"].as_f64().unwrap() + 9e-6;
        let beside = format!("/api/v1/cells/at?lat={beside}&lon={}", served["longitude_deg"]);
        assert_eq!(json_of(site.get(&beside).await).await["cell"], Value::Null);
        let near = json_of(site.get(&format!("{beside}&within_m=1.2")).await).await;
        assert_eq!(near["cell"]["index"], 5);
        assert!((near["distance_m"].as_f64().unwrap() - 1.0).abs() < 0.05, "{near}");

        let then = json_of(site.get(&format!("{}&epoch=1", at(served))).await).await;
        assert_eq!(then["cell"]["reason"], "seen by 1 contributor, 3 are needed");
        assert_eq!(site.get(&format!("{}&epoch=0", at(served))).await.status(), 404);
        for bad in [
            "/api/v1/cells/at?lat=NaN&lon=1",
            "/api/v1/cells/at?lat=30",
            &format!("{beside}&within_m=9"),
            &format!("{beside}&within_m=NaN"),
            &format!("/api/v1/tiles/{}/cells?limit=0", austin()),
            &format!("/api/v1/tiles/{}/cells?after=-1", austin()),
            "/api/v1/tiles/32614/x/1/cells",
        ] {
            assert_eq!(site.get(bad).await.status(), 400, "{bad}");
        }
    }

    /// Catches: viewers who learn where a single contributor drove, or who contributed.
    #[tokio::test]
    async fn viewers_are_told_of_what_is_served() {
        let site = site(gate_of("viewer")).await;
        let whole = cells(&site, "").await;
        let [served] = whole["cells"].as_array().unwrap().as_slice() else { panic!("{whole}") };
        let found = json_of(site.get(&at(served)).await).await;
        assert_eq!(found["cell"], *served, "and no hashes");
        assert_eq!(site.get(&format!("{}&epoch=2", at(served))).await.status(), 404, "not served yet");
    }
}
