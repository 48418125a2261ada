//! Browsers sign in with a token, and hold a cookie instead of it from then on. Scripts of a page cannot read it, and pages of
//! others do not send it.

use std::sync::Arc;

use axum::extract::rejection::JsonRejection;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use axum::{Json, http::StatusCode};
use serde::Deserialize;
use utoipa::ToSchema;

use super::App;
use super::answers::{CallerAnswer, ErrorAnswer, MALFORMED};
use super::error::Error;
use super::outside::Outside;
use crate::identity::{Caller, CookieScope, RemoteEnd, Role};

/// With what a browser signs in.
#[derive(Deserialize, ToSchema)]
#[schema(as = SignIn)]
#[serde(deny_unknown_fields)]
pub struct SessionBody {
    /// A bearer token of this service.
    token: String,
}

/// The other end of the connection, where a request came by one.
pub type OnPeer = Option<Extension<Arc<RemoteEnd>>>;

/// `GET /session`
#[utoipa::path(
    get,
    path = "/session",
    operation_id = "getSession",
    tag = "session",
    summary = "Who asks, and as what.",
    description = "",
    responses(
        (status = 200, description = "The caller.", body = CallerAnswer),
    )
)]
pub async fn who(
    State(app): State<Arc<App>>,
    Extension(caller): Extension<Arc<Caller>>,
    headers: HeaderMap,
) -> Response {
    let answer = caller_answer(&caller, app.gate.page_token(&headers));
    ([(header::CACHE_CONTROL, "no-store")], Json(answer)).into_response()
}

/// `POST /session`
#[utoipa::path(
    post,
    path = "/session",
    operation_id = "signIn",
    tag = "session",
    summary = "Sign a browser in with a token.",
    description = "",
    request_body = SessionBody,
    responses(
        (status = 200, description = "Signed in: the cookie `echofix_session` stands for the token from now on.", body = CallerAnswer, headers(("set-cookie" = String, description = "The session."))),
        (status = 400, description = MALFORMED, body = ErrorAnswer),
        (status = 401, description = "The token is not known.", body = ErrorAnswer),
    )
)]
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
    // The page asks `GET /session` for what it must bring: with the cookie that it now has.
    Ok((headers, Json(caller_answer(&caller, None))).into_response())
}

/// `DELETE /session`
#[utoipa::path(
    delete,
    path = "/session",
    operation_id = "signOut",
    tag = "session",
    summary = "Sign a browser out.",
    description = "",
    responses(
        (status = 204, description = "Signed out.", headers(("set-cookie" = String, description = "Ends the session."))),
    )
)]
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
pub(super) fn scope(outside: &Outside) -> CookieScope<'_> {
    CookieScope { path: &outside.prefix, encrypted: outside.encrypted }
}

fn caller_answer(caller: &Caller, csrf: Option<String>) -> CallerAnswer {
    CallerAnswer {
        csrf,
        name: caller.name.clone(),
        roles: caller.roles.iter().map(Role::name).collect(),
        known_by: caller.known.word(),
    }
}
