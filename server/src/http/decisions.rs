//! What operators decide: to revoke, to roll back, to undo either, to compact.
//!
//! Each body may hold `reason`, which the journal keeps, and `dry_run`, which only tells what would change.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::JsonRejection;
use axum::extract::{Extension, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;
use uuid::Uuid;

use super::App;
use super::answers::{
    BUSY, DECIDED, DecidedAnswer, ErrorAnswer, MALFORMED, NO_SUCH_EPOCH, PreviewAnswer, TakenAndGiven,
};
use super::catalog::progress_answer;
use super::contributor::parse_hash;
use super::day::parse_date;
use super::error::Error;
use super::operations::{audit, decision, difference, fresh, work};
use crate::identity::Caller;
use crate::shares::Peer;
use crate::store::{Contributor, LONGEST_REMARK, Preview, Proposal, Remark};

/// What is rolled back to.
#[derive(Deserialize, ToSchema)]
#[schema(as = Rollback)]
#[serde(deny_unknown_fields)]
pub struct RollbackBody {
    /// The last epoch that counts.
    epoch: u64,
    /// Why; the journal keeps it and the history tells it. 500 bytes at most.
    #[schema(max_length = 500)]
    reason: Option<String>,
    /// Only tell what would change.
    #[serde(default)]
    dry_run: bool,
}

/// `POST /api/v1/map/rollback`
#[utoipa::path(
    post,
    path = "/api/v1/map/rollback",
    operation_id = "rollBack",
    tag = "decisions",
    summary = "Take back all uploads and imports after an epoch.",
    description = "",
    request_body = RollbackBody,
    responses(
        (status = 200, description = DECIDED, body = DecidedAnswer),
        (status = 400, description = MALFORMED, body = ErrorAnswer),
        (status = 404, description = NO_SUCH_EPOCH, body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn rollback(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    body: Result<Json<RollbackBody>, JsonRejection>,
) -> Result<Response, Error> {
    let Json(RollbackBody { epoch, reason, dry_run }) = body?;
    decided(&app, (peer, &caller), Proposal::Rollback(epoch), reason, dry_run).await
}

/// What is revoked: one of the first three.
#[derive(Deserialize, ToSchema)]
#[schema(as = Revoke)]
#[serde(deny_unknown_fields)]
pub struct RevokeBody {
    /// A contributor, by its pseudonym.
    contributor: Option<String>,
    /// A contributor, by its keyed hash.
    #[schema(pattern = "^[0-9a-fA-F]{16}$")]
    contributor_hash: Option<String>,
    /// An upload or an imported file, by its id.
    #[schema(format = "uuid")]
    upload: Option<String>,
    /// Why; the journal keeps it and the history tells it. 500 bytes at most.
    #[schema(max_length = 500)]
    reason: Option<String>,
    /// Only tell what would change.
    #[serde(default)]
    dry_run: bool,
}

/// `POST /api/v1/map/revoke`
#[utoipa::path(
    post,
    path = "/api/v1/map/revoke",
    operation_id = "revoke",
    tag = "decisions",
    summary = "Take back what a contributor uploaded so far, or one upload or imported file.",
    description = "",
    request_body = RevokeBody,
    responses(
        (status = 200, description = DECIDED, body = DecidedAnswer),
        (status = 400, description = MALFORMED, body = ErrorAnswer),
        (status = 404, description = "There is nothing of it that is not compacted.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn revoke(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    body: Result<Json<RevokeBody>, JsonRejection>,
) -> Result<Response, Error> {
    let Json(RevokeBody { contributor, contributor_hash, upload, reason, dry_run }) = body?;
    let proposal = match (contributor, contributor_hash, upload) {
        (Some(name), None, None) => Proposal::RevokeContributor(Contributor::Pseudonym(name)),
        (None, Some(hash), None) => {
            let malformed = || {
                Error::BadRequest(format!(
                    "`{hash}` is no contributor hash; quarantine and history tell them"
                ))
            };
            Proposal::RevokeContributor(Contributor::Hash(parse_hash(&hash).ok_or_else(malformed)?))
        }
        (None, None, Some(id)) => {
            let malformed = |error| Error::BadRequest(format!("`{id}` is not a UUID: {error}"));
            Proposal::RevokeUpload(Uuid::try_parse(&id).map_err(malformed)?)
        }
        _ => {
            return Err(Error::BadRequest(
                "name one of `contributor`, `contributor_hash` and `upload`, and no other of them".to_owned(),
            ));
        }
    };
    decided(&app, (peer, &caller), proposal, reason, dry_run).await
}

/// What is undone.
#[derive(Deserialize, ToSchema)]
#[schema(as = Undo)]
#[serde(deny_unknown_fields)]
pub struct UndoBody {
    /// The number of the decision's record: its epoch in the history.
    decision: u64,
    /// Why; the journal keeps it and the history tells it. 500 bytes at most.
    #[schema(max_length = 500)]
    reason: Option<String>,
    /// Only tell what would change.
    #[serde(default)]
    dry_run: bool,
}

/// `POST /api/v1/map/undo`: a rollback, a revocation or an undoing
#[utoipa::path(
    post,
    path = "/api/v1/map/undo",
    operation_id = "undo",
    tag = "decisions",
    summary = "Undo a rollback, a revocation or an undoing: what it took back counts again.",
    description = "",
    request_body = UndoBody,
    responses(
        (status = 200, description = DECIDED, body = DecidedAnswer),
        (status = 400, description = MALFORMED, body = ErrorAnswer),
        (status = 404, description = "No decision that is in effect, or what it took back is compacted.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn undo(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    body: Result<Json<UndoBody>, JsonRejection>,
) -> Result<Response, Error> {
    let Json(UndoBody { decision, reason, dry_run }) = body?;
    decided(&app, (peer, &caller), Proposal::Undo(decision), reason, dry_run).await
}

/// What is compacted.
#[derive(Deserialize, ToSchema)]
#[schema(as = Compact)]
#[serde(deny_unknown_fields)]
pub struct CompactBody {
    /// Uploads that came before this UTC date.
    #[schema(format = Date)]
    before: String,
    /// Why; the journal keeps it and the history tells it. 500 bytes at most.
    #[schema(max_length = 500)]
    reason: Option<String>,
    /// Only tell what would change.
    #[serde(default)]
    dry_run: bool,
}

/// `POST /api/v1/map/compact`
#[utoipa::path(
    post,
    path = "/api/v1/map/compact",
    operation_id = "compact",
    tag = "decisions",
    summary = "Compact what was uploaded before a day: replace its records by a checkpoint. It can no longer be taken back, and nothing remembers who contributed it.",
    description = "",
    request_body = CompactBody,
    responses(
        (status = 200, description = DECIDED, body = DecidedAnswer),
        (status = 400, description = MALFORMED, body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn compact(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    body: Result<Json<CompactBody>, JsonRejection>,
) -> Result<Response, Error> {
    let Json(CompactBody { before, reason, dry_run }) = body?;
    let malformed = || Error::BadRequest(format!("`{before}` is no date; write it as 2026-12-31"));
    let day = parse_date(&before).ok_or_else(malformed)?;
    decided(&app, (peer, &caller), Proposal::Compact(day), reason, dry_run).await
}

/// `POST /api/v1/map/settle`
#[utoipa::path(
    post,
    path = "/api/v1/map/settle",
    operation_id = "settle",
    tag = "decisions",
    summary = "The former name of compacting.",
    description = "",
    request_body = CompactBody,
    responses(
        (status = 200, description = DECIDED, body = DecidedAnswer),
        (status = 400, description = MALFORMED, body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn settle(
    app: State<Arc<App>>,
    peer: Peer,
    caller: Extension<Arc<Caller>>,
    body: Result<Json<CompactBody>, JsonRejection>,
) -> Result<Response, Error> {
    compact(app, peer, caller, body).await
}

/// A decision's epoch, absent when there was nothing to decide, and how far the map is; or what it would change.
async fn decided(
    app: &App,
    (peer, caller): (Peer, &Arc<Caller>),
    proposal: Proposal,
    reason: Option<String>,
    dry_run: bool,
) -> Result<Response, Error> {
    let reason = reason.map(|reason| reason.trim().to_owned()).filter(|reason| !reason.is_empty());
    if reason.as_ref().is_some_and(|reason| reason.len() > LONGEST_REMARK) {
        return Err(Error::BadRequest(format!("the reason is longer than {LONGEST_REMARK} bytes")));
    }
    let map = || progress_answer(&app.state.store.progress().borrow());
    if dry_run {
        let undoable = !matches!(proposal, Proposal::Compact(_));
        let preview = work(app, peer, move |operations| Ok(operations.preview(&proposal)?)).await?;
        let dry_run = preview_answer(&preview, undoable);
        return Ok(fresh(DecidedAnswer::Foretold { dry_run, map: map() }));
    }
    let caller = Arc::clone(caller);
    let remark = Remark { by: caller.is_known().then(|| caller.title()), reason };
    let decided = decision(app, move |operations| {
        let epoch = operations.decide(&proposal, &remark)?;
        // Here, since who hangs up ends the request, and not what it began.
        audit(&caller, &in_words(&proposal), remark.reason.as_deref(), epoch);
        Ok(epoch)
    });
    let epoch = decided.await?;
    Ok(fresh(DecidedAnswer::Taken { epoch, map: map() }))
}

/// A decision for the log, which names no contributor.
fn in_words(proposal: &Proposal) -> String {
    match proposal {
        Proposal::RevokeContributor(_) => "revoke a contributor".to_owned(),
        Proposal::RevokeUpload(id) => format!("revoke upload {id}"),
        Proposal::Rollback(epoch) => format!("roll back to epoch {epoch}"),
        Proposal::Undo(decision) => format!("undo decision {decision}"),
        Proposal::Compact(day) => format!("compact what came before day {day}"),
    }
}

fn preview_answer(preview: &Preview, can_be_undone: bool) -> PreviewAnswer {
    PreviewAnswer {
        uploads: TakenAndGiven { taken_back: preview.uploads_out, given_back: preview.uploads_back },
        imported_tiles: TakenAndGiven { taken_back: preview.imports_out, given_back: preview.imports_back },
        contributors: preview.contributors,
        compacted: preview.compacted,
        can_be_undone,
        difference: difference(&preview.tiles),
    }
}

#[cfg(test)]
mod tests {
    use super::super::day::iso_date;
    use crate::grpc::now_us;
    use crate::http::testing::{StoredSite, json_of};
    use echofix_core::time::day_of;
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
        let tomorrow = iso_date(day_of(now_us()) + 1);
        let compacted = json_of(site.post("/api/v1/map/compact", &json!({ "before": tomorrow })).await).await;
        assert_eq!(compacted["epoch"], 9);
        // Older commands know it by its former name.
        let again = json_of(site.post("/api/v1/map/settle", &json!({ "before": tomorrow })).await).await;
        assert_eq!(again["epoch"], 10);
    }

    /// Catches: a dry run that decides, one that tells nothing, a reason that is lost, and a past that cannot be seen.
    #[tokio::test]
    async fn a_decision_is_foretold_taken_with_its_reason_and_undone() {
        let site = StoredSite::with_uploads(6).await;
        let body = |dry_run| json!({ "epoch": 4, "reason": " a shifted street ", "dry_run": dry_run });
        let foretold = json_of(site.post("/api/v1/map/rollback", &body(true)).await).await;
        let uploads = json!({ "taken_back": 2, "given_back": 0 });
        assert_eq!((&foretold["dry_run"]["uploads"], &foretold["map"]["journaled"]), (&uploads, &json!(6)));
        assert_eq!(foretold["dry_run"]["can_be_undone"], true);
        assert!(foretold["dry_run"]["tiles"][0]["corners"][3][1].is_f64(), "{foretold}");
        let before = json_of(site.get("/api/v1/map").await).await["totals"].clone();
        assert_eq!(json_of(site.post("/api/v1/map/rollback", &body(false)).await).await["epoch"], 7);
        site.caught_up().await;
        let after = json_of(site.get("/api/v1/map").await).await["totals"].clone();
        assert_ne!(before["cells"], after["cells"]);
        let past = json_of(site.get("/api/v1/map?epoch=6").await).await;
        assert_eq!((&past["totals"]["cells"], &past["epoch"]), (&before["cells"], &json!(6)));
        assert_eq!(site.get("/tiles/evidence/0/0/0.png?epoch=6").await.status(), 200);
        assert_eq!(site.get("/tiles/evidence/0/0/0.png?epoch=8").await.status(), 404);
        let then = json_of(site.get("/tiles/evidence.json?epoch=6").await).await;
        assert!(then["tiles"][0].as_str().unwrap().ends_with(".png?epoch=6"), "{then}");
        let undone = json_of(site.post("/api/v1/map/undo", &json!({ "decision": 7 })).await).await;
        assert_eq!(undone["epoch"], 8);
        site.caught_up().await;
        assert_eq!(json_of(site.get("/api/v1/map").await).await["totals"]["cells"], before["cells"]);
        let history = json_of(site.get("/api/v1/map/history").await).await;
        let events = history["events"].as_array().unwrap();
        assert_eq!((&events[0]["kind"], &events[0]["gives_back"]), (&json!("undo"), &json!(2)));
        assert_eq!((&events[1]["reason"], &events[1]["undone_by"]), (&json!("a shifted street"), &json!(8)));
        assert_eq!((&history["oldest"], &history["newest"]), (&json!(0), &json!(8)));
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
            ("/api/v1/map/revoke", json!({ "upload": "7", "contributor": "x" }), 400),
            ("/api/v1/map/revoke", json!({ "contributor_hash": "xyz" }), 400),
            ("/api/v1/map/revoke", json!({ "contributor_hash": "00000000000000ff" }), 404),
            ("/api/v1/map/revoke", json!({}), 400),
            ("/api/v1/map/undo", json!({ "decision": 1 }), 404),
            ("/api/v1/map/rollback", json!({ "epoch": 0, "reason": "x".repeat(501) }), 400),
            ("/api/v1/map/compact", json!({ "before": "2026-02-30" }), 400),
            ("/api/v1/map/compact", json!({ "before": "2149-01-01" }), 400),
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
        for path in ["rollback", "revoke", "undo", "compact", "settle", "import"] {
            let path = format!("/api/v1/map/{path}");
            let response = site.send(&path, "text/plain", br#"{"epoch": 1}"#.to_vec()).await;
            assert_eq!(response.status(), 400, "{path}");
        }
        assert_eq!(json_of(site.get("/api/v1/map").await).await["journaled"], 2);
    }
}
