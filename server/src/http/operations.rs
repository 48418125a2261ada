//! The map's history, and what operators decide about it.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::{JsonRejection, QueryRejection};
use axum::extract::{Query, State};
use axum::http::{Method, header};
use axum::response::{IntoResponse, Response};
use echofix_core::datum::Offset;
use echofix_core::geo::{Grid, Zone};
use echofix_core::point::MapPoint;
use echofix_core::vetting::Reason;
use echofix_core::vetting::alarm::{Alarm, AlarmKind, AlarmLimits, alarms};
use serde::Deserialize;
use serde_json::{Value, json};
use uuid::Uuid;

use super::App;
use super::catalog::progress_json;
use super::day::{iso_date, parse_date};
use super::error::Error;
use crate::store::{Decision, EventKind, HistoryEvent, Operations, QuarantinedRecord, TileDiff};
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
    limit: Result<Query<HistoryQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let limit = limit?.0.limit.unwrap_or(100);
    if !(1..=MAX_EVENTS).contains(&limit) {
        return Err(Error::BadRequest(format!("limit must lie within 1 and {MAX_EVENTS}")));
    }
    let events = work(&app, move |operations| Ok(operations.history(limit))).await?;
    let events: Vec<_> = events.iter().map(event).collect();
    Ok(fresh(json!({ "events": events })))
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
        EventKind::Control { at_us, decision, takes_back } => {
            let (kind, of) = match decision {
                Decision::RevokeContributor => ("revoke_contributor", Value::Null),
                Decision::RevokeUpload(id) => ("revoke_upload", id.to_string().into()),
                Decision::Rollback(epoch) => ("rollback", epoch.into()),
                Decision::Compact(last) => ("settle", last.into()),
            };
            json!({ "kind": kind, "of": of, "at_us": at_us, "takes_back": takes_back })
        }
    };
    if let (Some(body), Value::Object(rest)) = (body.as_object_mut(), rest) {
        body.extend(rest);
    }
    body
}

/// `GET /api/v1/map/quarantine`: uploads that were kept out of the map, and what they agree on
pub async fn quarantine(State(app): State<Arc<App>>) -> Result<Response, Error> {
    let (kept_out, alarms) = work(&app, |operations| {
        let kept_out = operations.quarantined()?;
        let entries: Vec<_> = kept_out.iter().map(|quarantined| quarantined.upload).collect();
        let alarms = alarms(&entries, &AlarmLimits::default());
        Ok((kept_out, alarms))
    })
    .await?;
    let alarms: Vec<_> = alarms.iter().map(alarm).collect();
    let newest = kept_out.iter().rev().take(MAX_EVENTS).map(quarantined);
    let uploads: Vec<_> = newest.collect();
    Ok(fresh(json!({ "quarantined": kept_out.len(), "uploads": uploads, "alarms": alarms })))
}

/// Why vetting kept an upload out, in one word.
pub fn reason_word(reason: Reason) -> &'static str {
    match reason {
        Reason::Shifted => "SHIFTED",
        Reason::Rotated => "ROTATED",
        Reason::Disagrees => "DISAGREES",
    }
}

fn quarantined(quarantined: &QuarantinedRecord) -> Value {
    let reason = reason_word(quarantined.reason);
    let upload = &quarantined.upload;
    json!({
        "epoch": quarantined.number, "reason": reason, "date": iso_date(upload.day),
        "place": position_json(upload.zone, upload.position), "offset": upload.offset.as_ref().map(offset),
    })
}

fn alarm(alarm: &Alarm) -> Value {
    let (kind, by) = match &alarm.kind {
        AlarmKind::Shift(by) => ("SHIFT", Some(offset(by))),
        AlarmKind::Changed => ("CHANGED", None),
    };
    json!({
        "kind": kind, "offset": by, "contributors": alarm.contributors, "since": iso_date(alarm.since),
        "place": position_json(alarm.zone, alarm.position),
    })
}

fn offset(offset: &Offset) -> Value {
    let pose = offset.pose();
    json!({ "east_m": pose.x_m, "north_m": pose.y_m, "yaw_deg": pose.yaw_rad.to_degrees() })
}

/// WGS-84 degrees of a point; nothing where the zone does not reach.
fn position_json(zone: Zone, point: MapPoint) -> Value {
    let at = Grid::new(zone).and_then(|grid| grid.unproject(point));
    at.map_or(Value::Null, |at| json!({ "lat": at.lat_deg, "lon": at.lon_deg }))
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
    span: Result<Query<DiffQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let Query(DiffQuery { from, to }) = span?;
    let diffs = work(&app, move |operations| Ok(operations.diff(from, to)?)).await?;
    let sum = |of: fn(&TileDiff) -> u32| diffs.iter().map(|diff| u64::from(of(diff))).sum::<u64>();
    let cells =
        json!({ "added": sum(|d| d.added), "removed": sum(|d| d.removed), "changed": sum(|d| d.changed) });
    let one = |diff: &TileDiff| {
        json!({
            "id": diff.id.to_string(),
            "added": diff.added,
            "removed": diff.removed,
            "changed": diff.changed,
        })
    };
    let named: Vec<_> = diffs.iter().take(MAX_TILES).map(one).collect();
    let body = json!({
        "from": from,
        "to": to,
        "cells": cells,
        "tiles_changed": diffs.len(),
        "tiles": named,
    });
    Ok(fresh(body))
}

/// What is rolled back to.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RollbackBody {
    epoch: u64,
}

/// `POST /api/v1/map/rollback`
pub async fn rollback(
    State(app): State<Arc<App>>,
    body: Result<Json<RollbackBody>, JsonRejection>,
) -> Result<Response, Error> {
    let Json(RollbackBody { epoch }) = body?;
    decided(&app, move |operations| Ok(Some(operations.rollback(epoch)?))).await
}

/// What is revoked.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub enum RevokeBody {
    /// All uploads of a contributor so far, by its pseudonym.
    #[serde(rename = "contributor")]
    Contributor(String),
    /// An upload or an imported file, by its id.
    #[serde(rename = "upload")]
    Upload(String),
}

/// `POST /api/v1/map/revoke`
pub async fn revoke(
    State(app): State<Arc<App>>,
    body: Result<Json<RevokeBody>, JsonRejection>,
) -> Result<Response, Error> {
    let Json(revoke) = body?;
    let work = move |operations: &dyn Operations| match revoke {
        RevokeBody::Contributor(pseudonym) => Ok(operations.revoke_contributor(&pseudonym)?),
        RevokeBody::Upload(id) => {
            let malformed = |error| Error::BadRequest(format!("`{id}` is not a UUID: {error}"));
            Ok(operations.revoke_upload(Uuid::try_parse(&id).map_err(malformed)?)?)
        }
    };
    decided(&app, move |operations| work(operations).map(Some)).await
}

/// What is compacted.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompactBody {
    /// Uploads that came before this UTC date.
    before: String,
}

/// `POST /api/v1/map/compact`, formerly `/api/v1/map/settle`
pub async fn compact(
    State(app): State<Arc<App>>,
    body: Result<Json<CompactBody>, JsonRejection>,
) -> Result<Response, Error> {
    let Json(CompactBody { before }) = body?;
    let malformed = || Error::BadRequest(format!("`{before}` is no date; write it as 2026-12-31"));
    let day = parse_date(&before).ok_or_else(malformed)?;
    decided(&app, move |operations| Ok(operations.compact(day)?)).await
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
    replay: Result<Query<VerifyQuery>, QueryRejection>,
) -> Result<Response, Error> {
    let Query(VerifyQuery { replay }) = replay?;
    if replay && method != Method::POST {
        return Err(Error::PostOnly("a replay"));
    }
    let found = work(&app, move |operations| Ok(operations.verify(replay)?)).await?;
    Ok(fresh(json!({
        "sound": found.damage.is_empty(),
        "records": found.records,
        "base_tiles": found.checkpoint_tiles,
        "tiles": found.tiles,
        "compared": found.compared,
        "damage": found.damage,
    })))
}

/// A decision's epoch, absent when there was nothing to decide, and how far the map is.
async fn decided(
    app: &App,
    decide: impl FnOnce(&dyn Operations) -> Result<Option<u64>, Error> + Send + 'static,
) -> Result<Response, Error> {
    let epoch = work(app, decide).await?;
    let map = progress_json(&app.state.store.progress().borrow());
    Ok(fresh(json!({ "epoch": epoch, "map": map })))
}

/// Runs blocking work under a permit of its own kind: it may take long, and pictures must not wait for it.
pub async fn work<T: Send + 'static>(
    app: &App,
    work: impl FnOnce(&dyn Operations) -> Result<T, Error> + Send + 'static,
) -> Result<T, Error> {
    let operations = Arc::clone(&app.state.operations);
    let permit = app.limiter.operate()?;
    tokio::task::spawn_blocking(in_current_span(move || {
        // Held by the work, not by the request.
        let _held = permit;
        work(&*operations)
    }))
    .await?
}

fn fresh(body: Value) -> Response {
    ([(header::CACHE_CONTROL, "no-store")], Json(body)).into_response()
}

#[cfg(test)]
mod tests {
    use crate::http::testing::{StoredSite, json_of};
    use serde_json::json;

    #[tokio::test]
    async fn history_is_listed_and_decided_about() {
        let site = StoredSite::with_uploads(6).await;
        let answer = site.post("/api/v1/map/rollback", &json!({ "epoch": 4 })).await;
        let body = json_of(answer).await;
        assert_eq!((&body["epoch"], &body["map"]["journaled"]), (&json!(7), &json!(7)));
        let upload = site.uploads[1].id.to_string();
        assert_eq!(site.post("/api/v1/map/revoke", &json!({ "upload": upload })).await.status(), 200);
        site.caught_up().await;
        let history = json_of(site.get("/api/v1/map/history").await).await;
        let kinds: Vec<_> = history["events"].as_array().unwrap().iter().map(|e| e["kind"].clone()).collect();
        assert_eq!(kinds, ["revoke_upload", "rollback", "uploads"]);
        assert_eq!(history["events"][2]["taken_back"], 3);
        assert_eq!((&history["events"][0]["of"], &history["events"][1]["of"]), (&json!(upload), &json!(4)));

        let diff = json_of(site.get("/api/v1/map/diff?from=6&to=8").await).await;
        assert!(diff["cells"]["removed"].as_u64().unwrap() > 0 && diff["cells"]["added"] == 0, "{diff}");
        assert_eq!(diff["tiles_changed"], diff["tiles"].as_array().unwrap().len());
        let plain = json_of(site.get("/api/v1/map/verify").await).await;
        assert_eq!((&plain["sound"], &plain["records"]), (&json!(true), &json!(8)));
        let started = site.get("/api/v1/map/verify?replay=true").await;
        assert_eq!(started.status(), 405, "a picture of a page could ask for this");
        let sound = json_of(site.post("/api/v1/map/verify?replay=true", &json!({})).await).await;
        assert_eq!((&sound["sound"], &sound["records"]), (&json!(true), &json!(8)));
        let compacted =
            json_of(site.post("/api/v1/map/compact", &json!({ "before": "2149-01-01" })).await).await;
        assert_eq!(compacted["epoch"], 9);
        // Older commands know it by its former name.
        let again = json_of(site.post("/api/v1/map/settle", &json!({ "before": "2149-01-01" })).await).await;
        assert_eq!(again["epoch"], 10);
    }

    #[tokio::test]
    async fn mistakes_are_reported() {
        let site = StoredSite::with_uploads(1).await;
        for (path, body, status) in [
            ("/api/v1/map/rollback", json!({ "epoch": 9 }), 404),
            ("/api/v1/map/rollback", json!({ "epoch": -1 }), 400),
            ("/api/v1/map/rollback", json!({}), 400),
            ("/api/v1/map/revoke", json!({ "contributor": "nobody" }), 404),
            ("/api/v1/map/revoke", json!({ "upload": "7" }), 400),
            ("/api/v1/map/revoke", json!({ "car": "7" }), 400),
            ("/api/v1/map/compact", json!({ "before": "2026-02-30" }), 400),
        ] {
            let response = site.post(path, &body).await;
            assert_eq!(response.status(), status, "{path} {body}");
            assert!(json_of(response).await["error"]["message"].is_string());
        }
        for (path, status) in [
            ("/api/v1/map/history?limit=0", 400),
            ("/api/v1/map/diff?from=0", 400),
            ("/api/v1/map/diff?from=0&to=2", 404),
            ("/api/v1/map/rollback", 405),
        ] {
            assert_eq!(site.get(path).await.status(), status, "{path}");
        }
    }

    #[tokio::test]
    async fn a_page_elsewhere_cannot_decide() {
        // A browser sends these without asking first; JSON it asks for.
        let site = StoredSite::with_uploads(2).await;
        for path in ["rollback", "revoke", "compact", "settle", "import"] {
            let path = format!("/api/v1/map/{path}");
            let response = site.send(&path, "text/plain", br#"{"epoch": 1}"#.to_vec()).await;
            assert_eq!(response.status(), 400, "{path}");
        }
        assert_eq!(json_of(site.get("/api/v1/map").await).await["journaled"], 2);
    }
}
