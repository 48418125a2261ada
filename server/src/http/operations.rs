//! The map's history, how maps of two epochs differ, and whether what is stored is sound.

use std::collections::BTreeSet;
use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Query, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use echofix_core::geo::{Grid, TileId};
use serde::{Deserialize, Serialize};

use super::App;
use super::answers::{
    BUSY, Cells, DiffAnswer, DifferenceAnswer, ErrorAnswer, EventAnswer, Happened, HistoryAnswer,
    NO_SUCH_EPOCH, RemarkedAnswer, TileDifference, VerifiedAnswer,
};
use super::contributor::hash_word;
use super::day::iso_date;
use super::error::Error;
use super::raster::corners;
use crate::identity::{Caller, Role};
use crate::shares::Peer;
use crate::store::{Decision, EventKind, HistoryEvent, Operations, TileDiff};
use crate::trace::in_current_span;

/// Tiles of a difference that are listed, at most.
const MAX_TILES: usize = 10_000;
/// Events of the history that are listed, at most.
const MAX_EVENTS: usize = 10_000;

/// `?limit=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct HistoryQuery {
    /// How many events.
    #[param(minimum = 1, maximum = 10000, default = 100)]
    limit: Option<usize>,
}

/// `GET /api/v1/map/history?limit=`, newest first
#[utoipa::path(
    get,
    path = "/api/v1/map/history",
    operation_id = "getHistory",
    tag = "history",
    summary = "What happened to the map since what was compacted.",
    description = "",
    params(HistoryQuery),
    responses(
        (status = 200, description = "Newest first.", body = HistoryAnswer),
        (status = 400, description = "A bad limit.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn history(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    limit: Result<Query<HistoryQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let limit = limit?.0.limit.unwrap_or(100);
    if !(1..=MAX_EVENTS).contains(&limit) {
        return Err(Error::BadRequest(format!("limit must lie within 1 and {MAX_EVENTS}")));
    }
    let operations = Arc::clone(&app.state.operations);
    // No operation that folds the map is waited for.
    let found = app.limiter.work(peer, move || {
        let kept_out = operations.quarantined().ok();
        let kept_out = kept_out.map(|kept_out| kept_out.iter().map(|record| record.number).collect());
        Ok((operations.history(limit), operations.epochs(), kept_out))
    });
    let (events, (oldest, newest), kept_out) = found.await?;
    let names = caller.may(Role::Operator);
    let events = events.into_iter().map(|told| event(told, names, kept_out.as_ref())).collect();
    Ok(fresh(HistoryAnswer { events, oldest, newest }))
}

/// An event, with the contributor's hash where it `names` one, when the records of the numbers of `kept_out` are in quarantine.
fn event(event: HistoryEvent, names: bool, kept_out: Option<&BTreeSet<u64>>) -> EventAnswer {
    let what = match event.what {
        EventKind::Uploads { uploads, contributors, taken_back } => {
            let quarantined =
                kept_out.map(|kept_out| kept_out.range(event.first..=event.last).count() as u64);
            Happened::Uploads { uploads, contributors, taken_back, quarantined }
        }
        EventKind::Import { file, tiles, taken_back } => {
            Happened::Import { file: file.to_string(), tiles, taken_back }
        }
        EventKind::Control { at_us, decision, takes_back, remark, undone_by } => {
            let remarked = RemarkedAnswer { at_us, by: remark.by, reason: remark.reason, undone_by };
            match decision {
                Decision::RevokeContributor(hash) => {
                    let of = names.then(|| hash_word(hash));
                    Happened::RevokeContributor { of, takes_back, remarked }
                }
                Decision::RevokeUpload(id) => {
                    Happened::RevokeUpload { of: id.to_string(), takes_back, remarked }
                }
                Decision::Rollback(of) => Happened::Rollback { of, takes_back, remarked },
                Decision::Undo(of) => Happened::Undo { of, gives_back: takes_back, remarked },
                Decision::Compact(of) => Happened::Settle { of, takes_back, remarked },
            }
        }
    };
    EventAnswer { first: event.first, last: event.last, date: iso_date(event.day), what }
}

/// `?from=&to=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct DiffQuery {
    /// The earlier epoch.
    from: u64,
    /// The later epoch.
    to: u64,
}

/// `GET /api/v1/map/diff?from=&to=`
#[utoipa::path(
    get,
    path = "/api/v1/map/diff",
    operation_id = "getDiff",
    tag = "history",
    summary = "How the map of one epoch differs from that of another.",
    description = "",
    params(DiffQuery),
    responses(
        (status = 200, description = "The difference.", body = DiffAnswer),
        (status = 400, description = "Not two epochs.", body = ErrorAnswer),
        (status = 404, description = NO_SUCH_EPOCH, body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn diff(
    State(app): State<Arc<App>>,
    peer: Peer,
    span: Result<Query<DiffQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let Query(DiffQuery { from, to }) = span?;
    let diffs = work(&app, peer, move |operations| Ok(operations.diff(from, to)?)).await?;
    Ok(fresh(DiffAnswer { from, to, difference: difference(&diffs) }))
}

/// How two maps differ.
pub(super) fn difference(diffs: &[TileDiff]) -> DifferenceAnswer {
    let sum = |of: fn(&TileDiff) -> u32| diffs.iter().map(|diff| u64::from(of(diff))).sum();
    let cells = |[added, removed, changed]: [u64; 3]| Cells { added, removed, changed };
    let one = |diff: &TileDiff| TileDifference {
        id: diff.id.to_string(),
        cells: cells([diff.added, diff.removed, diff.changed].map(u64::from)),
        corners: tile_corners(diff.id),
    };
    DifferenceAnswer {
        cells: cells([sum(|d| d.added), sum(|d| d.removed), sum(|d| d.changed)]),
        tiles_changed: diffs.len(),
        tiles: diffs.iter().take(MAX_TILES).map(one).collect(),
    }
}

/// Longitude and latitude of a tile's corners; nothing where the projection does not reach.
fn tile_corners(id: TileId) -> Option<[[f64; 2]; 4]> {
    let corners = Grid::new(id.zone).ok().and_then(|grid| corners(&grid, [id.x, id.y], [id.x, id.y]).ok())?;
    Some(corners.map(|at| [at.lon_deg, at.lat_deg]))
}

/// `?replay=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct VerifyQuery {
    /// Also fold the journal again and compare; only POST may ask for it.
    #[param(default = false, required = false)]
    #[serde(default)]
    replay: bool,
}

type VerifyParameters = Result<Query<VerifyQuery>, QueryRejection>;

/// `GET /api/v1/map/verify`: folding the journal again takes a core for a minute, which no picture of a page shall start
#[utoipa::path(
    get,
    path = "/api/v1/map/verify",
    operation_id = "verify",
    tag = "files",
    summary = "Read all that is stored and check it.",
    description = "",
    params(VerifyQuery),
    responses(
        (status = 200, description = "What was found.", body = VerifiedAnswer),
        (status = 400, description = "A bad parameter.", body = ErrorAnswer),
        (status = 405, description = "A replay is work: it is asked for with POST.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn verify(
    State(app): State<Arc<App>>,
    peer: Peer,
    replay: VerifyParameters,
) -> Result<Response, Error> {
    if replay?.0.replay {
        return Err(Error::PostOnly("a replay"));
    }
    verified(&app, peer, false).await
}

/// `POST /api/v1/map/verify?replay=true`
#[utoipa::path(
    post,
    path = "/api/v1/map/verify",
    operation_id = "verifyWithReplay",
    tag = "files",
    summary = "Read all that is stored and check it, and fold the journal again where that is asked for.",
    description = "",
    params(VerifyQuery),
    responses(
        (status = 200, description = "What was found.", body = VerifiedAnswer),
        (status = 400, description = "A bad parameter.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn verify_with_replay(
    State(app): State<Arc<App>>,
    peer: Peer,
    replay: VerifyParameters,
) -> Result<Response, Error> {
    verified(&app, peer, replay?.0.replay).await
}

async fn verified(app: &App, peer: Peer, replay: bool) -> Result<Response, Error> {
    let found = work(app, peer, move |operations| Ok(operations.verify(replay)?)).await?;
    Ok(fresh(VerifiedAnswer {
        sound: found.damage.is_empty(),
        records: found.records,
        base_tiles: found.checkpoint_tiles,
        tiles: found.tiles,
        compared: found.compared,
        damage: found.damage,
    }))
}

/// Every decision is told in the log: who took it, how that is known, from where, what it is, and why.
pub(super) fn audit(caller: &Caller, what: &str, why: Option<&str>, epoch: Option<u64>) {
    tracing::info!(target: "echofix_server::audit", %caller, what, why, epoch, "decided");
}

/// Runs blocking work under a permit of its own kind: it may take long, and pictures must not wait for it.
pub async fn work<T: Send + 'static>(
    app: &App,
    peer: Peer,
    work: impl FnOnce(&dyn Operations) -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    held(app, app.limiter.operate(peer)?, work).await
}

/// The same for what changes the map.
pub async fn decision<T: Send + 'static>(
    app: &App,
    decide: impl FnOnce(&dyn Operations) -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    held(app, app.limiter.decide()?, decide).await
}

async fn held<T: Send + 'static>(
    app: &App,
    permit: impl Send + 'static,
    work: impl FnOnce(&dyn Operations) -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    let operations = Arc::clone(&app.state.operations);
    tokio::task::spawn_blocking(in_current_span(move || {
        // Held by the work, not by the request.
        let _held = permit;
        work(&*operations)
    }))
    .await?
}

/// An answer that nobody keeps.
pub(super) fn fresh(body: impl Serialize) -> Response {
    ([(header::CACHE_CONTROL, "no-store")], Json(body)).into_response()
}
