//! Browsers sign in, with a token or at an issuer, and out.

use std::time::Instant;

use axum::http::HeaderMap;

use super::caller::{Caller, Known};
use super::gate::Gate;
use super::headers::{CookieScope, cookie, cookie_named, flow_cookie, session};
use super::jwt::Told;
use super::oidc::{self, Answered, FLOW_COOKIE, NotSignedIn};
use super::refusal::{Refusal, refused};
use super::remote_end::RemoteEnd;
use super::sessions::{Basis, LASTS, page_token};
use crate::shares;

impl Gate {
    /// Begins a browser's session with a token; returns the cookie that stands for it.
    ///
    /// # Errors
    /// When the token is not known, or the system has no randomness.
    pub fn sign_in(
        &self,
        token: &str,
        end: Option<&RemoteEnd>,
        scope: CookieScope<'_>,
    ) -> Result<(Caller, String), Refusal> {
        let (caller, basis) = self.bearer(token, end)?;
        let id = self.sessions.begin(&caller.name, basis, Instant::now());
        let id = id.map_err(|error| refused(&format!("no session can begin: {error}")))?;
        let lasts = LASTS.as_secs();
        Ok((caller, cookie(&id, lasts, self.within(scope, end))))
    }

    /// By which ways a browser may sign in: with a token, at an issuer.
    #[must_use]
    pub fn ways(&self) -> (bool, bool) {
        let tokens = !self.identity.tokens.is_empty() || !self.identity.jwt_jwks.is_empty();
        (tokens, !self.identity.oidc_issuer.is_empty())
    }

    /// Begins to sign a browser in at the issuer: where it is sent, and the cookie that it will be known by.
    ///
    /// # Errors
    /// When there is no issuer, or it cannot be asked.
    pub async fn begin_at_issuer(
        &self,
        from: shares::Peer,
        end: Option<&RemoteEnd>,
        scope: CookieScope<'_>,
    ) -> Result<(String, String), NotSignedIn> {
        if !self.ways().1 {
            return Err(NotSignedIn::NotConfigured);
        }
        let (location, id) = self.flows.begin(&self.identity, from).await?;
        Ok((location, flow_cookie(&id, oidc::LASTS.as_secs(), self.at_issuer(scope, end))))
    }

    /// Begins the session of a browser that the issuer sent back: its cookie.
    ///
    /// # Errors
    /// When it is not known who that is, or they may nothing.
    pub async fn finish_at_issuer(
        &self,
        answered: Answered,
        (end, headers): (Option<&RemoteEnd>, &HeaderMap),
        scope: CookieScope<'_>,
    ) -> Result<(Caller, String), NotSignedIn> {
        if !self.ways().1 {
            return Err(NotSignedIn::NotConfigured);
        }
        let asking = (&self.identity, self.secret.as_deref());
        let Told { name, roles, lease } =
            self.flows.finish(asking, cookie_named(headers, FLOW_COOKIE), answered).await?;
        let address = end.map(|end| end.address);
        let caller = Caller { name, roles, known: Known::Oidc, address, lease: Some(lease) };
        let id = self.sessions.begin(&caller.name, Basis::Jwt(caller.clone()), Instant::now());
        let id = id.map_err(|error| NotSignedIn::Issuer(error.to_string()))?;
        Ok((caller, cookie(&id, self.identity.oidc_session_s, self.at_issuer(scope, end))))
    }

    /// The cookie that forgets a browser which began to sign in.
    #[must_use]
    pub fn flow_ended(&self, end: Option<&RemoteEnd>, scope: CookieScope<'_>) -> String {
        flow_cookie("", 0, self.at_issuer(scope, end))
    }

    /// Browsers know this port by the address that the issuer sends them back to.
    fn at_issuer<'a>(&self, scope: CookieScope<'a>, end: Option<&RemoteEnd>) -> CookieScope<'a> {
        let CookieScope { path, encrypted } = self.within(scope, end);
        CookieScope { path, encrypted: encrypted || self.identity.oidc_redirect.starts_with("https:") }
    }

    /// Looks at the issuer's keys again, where browsers sign in at one.
    pub(super) async fn refresh_issuer(&self) -> Result<(), String> {
        self.flows.refresh(&self.identity).await
    }

    /// What a page must bring with the changes that it makes in the session of a request; none without one.
    #[must_use]
    pub fn page_token(&self, headers: &HeaderMap) -> Option<String> {
        let id = session(headers)?;
        self.sessions.basis(id, Instant::now()).map(|_| page_token(id))
    }

    /// Ends the session of a request; returns the cookie that says so to the browser.
    pub fn sign_out(&self, end: Option<&RemoteEnd>, headers: &HeaderMap, scope: CookieScope<'_>) -> String {
        session(headers).inspect(|id| self.sessions.end(id));
        cookie("", 0, self.within(scope, end))
    }

    /// Is a browser's connection encrypted, here or by something in front?
    fn within<'a>(&self, scope: CookieScope<'a>, end: Option<&RemoteEnd>) -> CookieScope<'a> {
        let encrypted = scope.encrypted || self.identity.plaintext || end.is_some_and(|end| end.encrypted);
        CookieScope { encrypted, ..scope }
    }
}
