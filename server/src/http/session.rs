//! Browsers sign in with a token, and hold a cookie instead of it from then on. Scripts of a page cannot read it, and pages of
//! others do not send it.

use std::sync::Arc;

use axum::extract::rejection::JsonRejection;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use axum::{Json, http::StatusCode};
use serde::Deserialize;
use serde_json::{Value, json};

use super::App;
use super::error::Error;
use super::outside::Outside;
use crate::identity::{Caller, CookieScope, Peer, Role};

/// With what a browser signs in.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionBody {
    token: String,
}

type OnPeer = Option<Extension<Arc<Peer>>>;

/// `GET /session`
pub async fn who(Extension(caller): Extension<Arc<Caller>>) -> Response {
    ([(header::CACHE_CONTROL, "no-store")], Json(caller_json(&caller))).into_response()
}

/// `POST /session`
pub async fn sign_in(
    State(app): State<Arc<App>>,
    peer: OnPeer,
    Extension(outside): Extension<Outside>,
    body: Result<Json<SessionBody>, JsonRejection>,
) -> Result<Response, Error> {
    let Json(SessionBody { token }) = body?;
    let (caller, cookie) =
        app.gate.sign_in(token.trim(), peer.as_deref().map(|peer| &**peer), scope(&outside))?;
    tracing::info!(%caller, "signed in");
    let headers = [(header::CACHE_CONTROL, "no-store".to_owned()), (header::SET_COOKIE, cookie)];
    Ok((headers, Json(caller_json(&caller))).into_response())
}

/// `DELETE /session`
pub async fn sign_out(
    State(app): State<Arc<App>>,
    peer: OnPeer,
    Extension(outside): Extension<Outside>,
    headers: HeaderMap,
) -> Response {
    let cookie = app.gate.sign_out(peer.as_deref().map(|peer| &**peer), &headers, scope(&outside));
    (StatusCode::NO_CONTENT, [(header::SET_COOKIE, cookie)]).into_response()
}

/// Other programs of a proxy's name are not sent this one's sessions.
fn scope(outside: &Outside) -> CookieScope<'_> {
    CookieScope { path: &outside.prefix, encrypted: outside.encrypted }
}

fn caller_json(caller: &Caller) -> Value {
    let roles: Vec<_> = caller.roles.iter().map(Role::name).collect();
    json!({ "name": caller.name, "roles": roles, "known_by": caller.known.word() })
}
