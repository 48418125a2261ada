//! The map's history, how maps of two epochs differ, and whether what is stored is sound.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::{Method, header};
use axum::response::{IntoResponse, Response};
use echofix_core::geo::{Grid, TileId};
use serde::Deserialize;
use serde_json::{Value, json};

use super::App;
use super::contributor::hash_word;
use super::day::iso_date;
use super::error::Error;
use super::raster::corners;
use crate::identity::Caller;
use crate::shares::Peer;
use crate::store::{Decision, EventKind, HistoryEvent, Operations, TileDiff};
use crate::trace::in_current_span;

/// Tiles of a difference that are listed, at most.
const MAX_TILES: usize = 10_000;
/// Events of the history that are listed, at most.
const MAX_EVENTS: usize = 10_000;

/// `?limit=`
#[derive(Deserialize)]
pub struct HistoryQuery {
    limit: Option<usize>,
}

/// `GET /api/v1/map/history?limit=`, newest first
pub async fn history(
    State(app): State<Arc<App>>,
    peer: Peer,
    limit: Result<Query<HistoryQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let limit = limit?.0.limit.unwrap_or(100);
    if !(1..=MAX_EVENTS).contains(&limit) {
        return Err(Error::BadRequest(format!("limit must lie within 1 and {MAX_EVENTS}")));
    }
    let operations = Arc::clone(&app.state.operations);
    // It is read from memory: no operation that folds the map is waited for.
    let found = app.limiter.work(peer, move || Ok((operations.history(limit), operations.epochs())));
    let (events, (oldest, newest)) = found.await?;
    let events: Vec<_> = events.iter().map(event).collect();
    Ok(fresh(json!({ "events": events, "oldest": oldest, "newest": newest })))
}

fn event(event: &HistoryEvent) -> Value {
    let mut body = json!({ "first": event.first, "last": event.last, "date": iso_date(event.day) });
    let rest = match event.what {
        EventKind::Uploads { uploads, contributors, taken_back } => json!({
            "kind": "uploads", "uploads": uploads, "contributors": contributors, "taken_back": taken_back,
        }),
        EventKind::Import { file, tiles, taken_back } => json!({
            "kind": "import", "file": file.to_string(), "tiles": tiles, "taken_back": taken_back,
        }),
        EventKind::Control { at_us, decision, takes_back, ref remark, undone_by } => {
            let (kind, of): (_, Value) = match decision {
                Decision::RevokeContributor(hash) => ("revoke_contributor", hash_word(hash).into()),
                Decision::RevokeUpload(id) => ("revoke_upload", id.to_string().into()),
                Decision::Rollback(epoch) => ("rollback", epoch.into()),
                Decision::Undo(number) => ("undo", number.into()),
                Decision::Compact(last) => ("settle", last.into()),
            };
            let mut body = json!({
                "kind": kind, "of": of, "at_us": at_us, "by": remark.by, "reason": remark.reason, "undone_by": undone_by,
            });
            let effect = if kind == "undo" { "gives_back" } else { "takes_back" };
            body[effect] = takes_back.into();
            body
        }
    };
    if let (Some(body), Value::Object(rest)) = (body.as_object_mut(), rest) {
        body.extend(rest);
    }
    body
}

/// `?from=&to=`
#[derive(Deserialize)]
pub struct DiffQuery {
    from: u64,
    to: u64,
}

/// `GET /api/v1/map/diff?from=&to=`
pub async fn diff(
    State(app): State<Arc<App>>,
    peer: Peer,
    span: Result<Query<DiffQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let Query(DiffQuery { from, to }) = span?;
    let diffs = work(&app, peer, move |operations| Ok(operations.diff(from, to)?)).await?;
    let mut body = diffs_json(&diffs);
    (body["from"], body["to"]) = (from.into(), to.into());
    Ok(fresh(body))
}

/// How two maps differ.
pub(super) fn diffs_json(diffs: &[TileDiff]) -> Value {
    let sum = |of: fn(&TileDiff) -> u32| diffs.iter().map(|diff| u64::from(of(diff))).sum::<u64>();
    let cells =
        json!({ "added": sum(|d| d.added), "removed": sum(|d| d.removed), "changed": sum(|d| d.changed) });
    let one = |diff: &TileDiff| {
        json!({
            "id": diff.id.to_string(),
            "added": diff.added,
            "removed": diff.removed,
            "changed": diff.changed,
            "corners": tile_corners(diff.id),
        })
    };
    let named: Vec<_> = diffs.iter().take(MAX_TILES).map(one).collect();
    json!({ "cells": cells, "tiles_changed": diffs.len(), "tiles": named })
}

/// Longitude and latitude of a tile's corners; nothing where the projection does not reach.
fn tile_corners(id: TileId) -> Option<[[f64; 2]; 4]> {
    let corners = Grid::new(id.zone).ok().and_then(|grid| corners(&grid, [id.x, id.y], [id.x, id.y]).ok())?;
    Some(corners.map(|at| [at.lon_deg, at.lat_deg]))
}

/// `?replay=`
#[derive(Deserialize)]
pub struct VerifyQuery {
    #[serde(default)]
    replay: bool,
}

/// `GET /api/v1/map/verify`, and `POST /api/v1/map/verify?replay=true`: folding the journal again takes a core for a minute,
/// which no picture of a page shall start
pub async fn verify(
    method: Method,
    State(app): State<Arc<App>>,
    peer: Peer,
    replay: Result<Query<VerifyQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let Query(VerifyQuery { replay }) = replay?;
    if replay && method != Method::POST {
        return Err(Error::PostOnly("a replay"));
    }
    let found = work(&app, peer, move |operations| Ok(operations.verify(replay)?)).await?;
    Ok(fresh(json!({
        "sound": found.damage.is_empty(),
        "records": found.records,
        "base_tiles": found.checkpoint_tiles,
        "tiles": found.tiles,
        "compared": found.compared,
        "damage": found.damage,
    })))
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

pub(super) fn fresh(body: Value) -> Response {
    ([(header::CACHE_CONTROL, "no-store")], Json(body)).into_response()
}
