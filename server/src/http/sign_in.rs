//! Browsers sign in at an issuer: they are sent there, and come back with a code.
//!
//! The cookie of the session is strict: it would not go with a redirect from the issuer's page. So a lax one, which counts once
//! and for minutes, tells which browser began; the session's cookie is first needed by the console, which asks from its own page.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Query, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{AppendHeaders, IntoResponse, Response};

use super::App;
use super::answers::{ErrorAnswer, SignInWaysAnswer};
use super::error::Error;
use super::outside::Outside;
use super::session::{OnPeer, scope};
use crate::identity::Answered;
use crate::shares::Peer;

/// The console, from where the issuer sends browsers back to.
const CONSOLE: &str = "../";

/// `GET /session/ways`
#[utoipa::path(
    get,
    path = "/session/ways",
    operation_id = "getSignInWays",
    tag = "session",
    summary = "By which ways a browser may sign in.",
    description = "",
    responses((status = 200, description = "The ways.", body = SignInWaysAnswer))
)]
pub async fn ways(State(app): State<Arc<App>>) -> Response {
    let (token, oidc) = app.gate.ways();
    ([(header::CACHE_CONTROL, "no-store")], Json(SignInWaysAnswer { token, oidc })).into_response()
}

/// `GET /session/oidc`
#[utoipa::path(
    get,
    path = "/session/oidc",
    operation_id = "signInAtIssuer",
    tag = "session",
    summary = "Send a browser to the issuer, to sign in.",
    description = "",
    responses(
        (status = 303, description = "To the issuer; a cookie tells which browser it is.", headers(("location" = String, description = "The issuer's address."), ("set-cookie" = String, description = "For ten minutes."))),
        (status = 404, description = "Nobody signs in at an issuer here.", body = ErrorAnswer),
        (status = 502, description = "The issuer cannot be asked.", body = ErrorAnswer),
    )
)]
pub async fn begin(
    State(app): State<Arc<App>>,
    from: Peer,
    end: OnPeer,
    Extension(outside): Extension<Outside>,
) -> Result<Response, Error> {
    let end = end.as_deref().map(|end| &**end);
    let (location, cookie) = app.gate.begin_at_issuer(from, end, scope(&outside)).await?;
    let headers = [
        (header::LOCATION, location),
        (header::SET_COOKIE, cookie),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ];
    Ok((StatusCode::SEE_OTHER, headers).into_response())
}

/// `GET /session/callback`
#[utoipa::path(
    get,
    path = "/session/callback",
    operation_id = "signedInAtIssuer",
    tag = "session",
    summary = "Where the issuer sends browsers back to.",
    description = "",
    params(
        ("code" = Option<String>, Query, description = "What stands for the ID token."),
        ("state" = Option<String>, Query, description = "What was sent along."),
        ("iss" = Option<String>, Query, description = "Who answers."),
        ("error" = Option<String>, Query, description = "Why there is no code."),
        ("error_description" = Option<String>, Query, description = "The same for people."),
    ),
    responses(
        (status = 303, description = "Signed in, and on to the console.", headers(("location" = String, description = "The console."), ("set-cookie" = String, description = "The session."))),
        (status = 400, description = "Not what issuers send.", body = ErrorAnswer),
        (status = 401, description = "It is not known who that is, or they may nothing.", body = ErrorAnswer),
        (status = 404, description = "Nobody signs in at an issuer here.", body = ErrorAnswer),
        (status = 502, description = "The issuer cannot be asked.", body = ErrorAnswer),
    )
)]
pub async fn finish(
    State(app): State<Arc<App>>,
    end: OnPeer,
    Extension(outside): Extension<Outside>,
    headers: HeaderMap,
    answered: Result<Query<Answered>, QueryRejection>,
) -> Result<Response, Error> {
    let Query(answered) = answered?;
    let end = end.as_deref().map(|end| &**end);
    let ended = AppendHeaders([
        (header::SET_COOKIE, app.gate.flow_ended(end, scope(&outside))),
        (header::CACHE_CONTROL, "no-store".to_owned()),
    ]);
    match app.gate.finish_at_issuer(answered, (end, &headers), scope(&outside)).await {
        Ok((caller, cookie)) => {
            tracing::info!(%caller, "signed in");
            let signed_in = [(header::LOCATION, CONSOLE.to_owned()), (header::SET_COOKIE, cookie)];
            // Both cookies: what is appended comes after what is set.
            Ok((StatusCode::SEE_OTHER, signed_in, ended, ()).into_response())
        }
        Err(error) => Ok((ended, Error::from(error)).into_response()),
    }
}
