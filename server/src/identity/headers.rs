//! What requests and answers carry of who asks: tokens, cookies, and what a page brings with a change.

use axum::http::{HeaderMap, header};

use super::access::Call;
use super::oidc::FLOW_COOKIE;
use super::refusal::{Refusal, refused};
use super::sessions::{COOKIE, page_token};
use super::tokens::hash_of;

/// The header in which a page brings what it must with each change.
pub const PAGE_TOKEN: &str = "x-echofix-csrf";

/// Where a browser's cookie goes.
#[derive(Debug, Clone, Copy)]
pub struct CookieScope<'a> {
    /// The path under which the port is shown; empty for the root.
    pub path: &'a str,
    /// Whether what is in front says that the browser's connection is encrypted.
    pub encrypted: bool,
}

/// The cookie of a session: no script reads it, and no other site sends it.
pub(super) fn cookie(id: &str, lasts_s: u64, CookieScope { path, encrypted }: CookieScope<'_>) -> String {
    let secure = if encrypted { "; Secure" } else { "" };
    let path = if path.is_empty() { "/" } else { path };
    format!("{COOKIE}={id}; Path={path}; Max-Age={lasts_s}; HttpOnly; SameSite=Strict{secure}")
}

/// The cookie of a browser that signs in at the issuer, whose redirect is to bring it: a strict one would not go with that.
pub(super) fn flow_cookie(
    id: &str,
    lasts_s: u64,
    CookieScope { path, encrypted }: CookieScope<'_>,
) -> String {
    let secure = if encrypted { "; Secure" } else { "" };
    format!("{FLOW_COOKIE}={id}; Path={path}/session; Max-Age={lasts_s}; HttpOnly; SameSite=Lax{secure}")
}

/// The token of a request; an error when there is something else in its place.
pub(super) fn bearer(headers: &HeaderMap) -> Result<Option<&str>, Refusal> {
    let mut values = headers.get_all(header::AUTHORIZATION).iter();
    let Some(value) = values.next() else { return Ok(None) };
    let token = value.to_str().ok().and_then(|value| {
        let (scheme, token) = value.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
    });
    match (token, values.next()) {
        (Some(token), None) => Ok(Some(token)),
        _ => Err(refused("the authorization header is not one `Bearer TOKEN`")),
    }
}

/// Whether a change comes without what the session's page knows. Signing in anew changes nothing of the old session.
pub(super) fn is_forged(call: Call<'_>, id: &str, headers: &HeaderMap) -> bool {
    if matches!(call, Call::Http("GET" | "HEAD", _) | Call::Http("POST", "/session")) {
        return false;
    }
    let brought = headers.get(PAGE_TOKEN).and_then(|value| value.to_str().ok());
    // Compared by hashes: the time that it takes tells nothing.
    brought.map(hash_of) != Some(hash_of(&page_token(id)))
}

/// The id of a browser's session.
pub(super) fn session(headers: &HeaderMap) -> Option<&str> {
    cookie_named(headers, COOKIE)
}

/// The value of a cookie.
pub(super) fn cookie_named<'a>(headers: &'a HeaderMap, wanted: &str) -> Option<&'a str> {
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, _)| *name == wanted).map(|(_, id)| id)
}
