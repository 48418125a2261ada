//! From a request's connection and headers to its caller, and whether that may do it. Both ports ask here.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use arc_swap::ArcSwap;
use axum::http::HeaderMap;
use rustls::pki_types::CertificateDer;

use super::access::{self, Access, Call};
use super::caller::{Caller, Known};
use super::certificate::role_and_name;
use super::config::{Error, IdentityConfig, Strangers, TlsConfig, TlsError, check};
use super::headers::{bearer, is_forged, session};
use super::jwt::{self, Told};
use super::oidc::{self, Flows};
use super::refusal::{Refusal, refused};
use super::remote_end::{Closing, Entry, RemoteEnd, RemoteEnds};
use super::role::{Role, Roles};
use super::sessions::{Basis, Sessions};
use super::tls::{Files, Identified, now_s};
use super::tokens::{TokenHash, hash_of};
use crate::listen::{ListenAddress, RemoteAddress};

/// Who is let in, and for what.
pub struct Gate {
    tls: TlsConfig,
    pub(super) identity: IdentityConfig,
    strangers: Strangers,
    current: ArcSwap<Identified>,
    /// What it was made from.
    files: Mutex<Files>,
    ends: Arc<RemoteEnds>,
    pub(super) sessions: Sessions,
    pub(super) flows: Flows,
    /// What proves this service to the issuer.
    pub(super) secret: Option<String>,
    /// The address of an issuer's keys.
    keys: jwt::Source,
}

impl Gate {
    /// Asks nobody: for routes without a port.
    #[must_use]
    pub fn open() -> Self {
        let (tls, identity) = (TlsConfig::default(), IdentityConfig::default());
        Self::with(tls, identity, Strangers::Unasked, (Files::default(), Identified::default()))
    }

    fn with(
        tls: TlsConfig,
        identity: IdentityConfig,
        strangers: Strangers,
        (files, current): (Files, Identified),
    ) -> Self {
        let (ends, sessions, current) = (Arc::default(), Sessions::default(), ArcSwap::from_pointee(current));
        let files = Mutex::new(files);
        let (keys, flows, secret) = (jwt::Source::default(), Flows::default(), None);
        Self { tls, identity, strangers, current, files, ends, sessions, flows, secret, keys }
    }

    /// As configured, for ports at these addresses. Reads the files.
    ///
    /// # Errors
    /// When others reach a port and nobody is asked, or a file cannot be used.
    pub fn of(tls: &TlsConfig, identity: &IdentityConfig, listen: &[ListenAddress]) -> Result<Self, Error> {
        check(tls, identity, listen)?;
        let files = Files::read(tls, identity, &jwt::Source::default())?;
        let identified = Identified::of(&files, tls, identity)?;
        let strangers = identity.strangers(tls);
        let secret = oidc::client_secret(identity)?;
        Ok(Self { secret, ..Self::with(tls.clone(), identity.clone(), strangers, (files, identified)) })
    }

    /// What connections are held against from now on.
    #[must_use]
    pub fn current(&self) -> Arc<Identified> {
        self.current.load_full()
    }

    /// Reads the files again, and replaces what changed if all of it can be used. Connections that no longer pass are ended.
    ///
    /// # Errors
    /// When a file cannot be used; the last good ones stay.
    pub(super) fn refresh(&self) -> Result<(bool, usize), TlsError> {
        let changed = self.replace();
        let all = changed.as_ref().is_ok_and(|changed| *changed);
        let ended = self.ends.sweep(&self.current.load(), all);
        changed.map(|changed| (changed, ended))
    }

    fn replace(&self) -> Result<bool, TlsError> {
        let fresh = Files::read(&self.tls, &self.identity, &self.keys)?;
        let mut files = self.files.lock().unwrap_or_else(PoisonError::into_inner);
        if *files == fresh {
            return Ok(false);
        }
        self.current.store(Arc::new(Identified::of(&fresh, &self.tls, &self.identity)?));
        *files = fresh;
        Ok(true)
    }

    /// How often the files are looked at.
    pub(super) fn period(&self) -> std::time::Duration {
        std::time::Duration::from_secs(self.tls.reload_s.max(1))
    }

    /// Whether there is any file to look at.
    pub(super) fn has_files(&self) -> bool {
        self.tls.is_on() || !self.identity.tokens.is_empty() || !self.identity.jwt_jwks.is_empty()
    }

    /// Takes a connection in, with the certificates it showed, its own first.
    #[must_use]
    pub fn enter(
        &self,
        address: RemoteAddress,
        encrypted: bool,
        chain: Option<&[CertificateDer<'_>]>,
    ) -> (Entry, Closing) {
        let (end, closing) = RemoteEnd::new(address, encrypted, chain, &self.identity.trust_domain);
        (self.ends.enter(end), closing)
    }

    /// Ends a connection that was let in by what no longer counts: what changed between its beginning and its entry.
    pub fn recheck(&self, before: &Arc<Identified>, end: &RemoteEnd) {
        let now = self.current.load();
        if !Arc::ptr_eq(before, &now) && !end.passes(&now) {
            end.end();
        }
    }

    /// What callers may do whom nothing identifies, for people; `None` when they may nothing, or nobody is asked.
    #[must_use]
    pub fn anonymous(&self) -> Option<Roles> {
        match self.strangers {
            Strangers::With(roles) if !roles.is_empty() => Some(roles),
            _ => None,
        }
    }

    /// Who makes a call, if they may.
    ///
    /// # Errors
    /// Why they may not.
    pub fn admit(
        &self,
        call: Call<'_>,
        end: Option<&RemoteEnd>,
        headers: &HeaderMap,
    ) -> Result<Caller, Refusal> {
        let access = access::of(call).ok_or(Refusal::NotServed)?;
        let caller = self.caller(call, end, headers);
        let least = match access {
            Access::Open => None,
            Access::Metrics if self.identity.open_metrics => None,
            Access::Metrics => Some(Role::Viewer),
            Access::Least(role) => Some(role),
            Access::AnyRole => {
                return caller
                    .and_then(|caller| if caller.roles.is_empty() { Err(unknown()) } else { Ok(caller) });
            }
        };
        let nobody = || Caller {
            name: String::new(),
            roles: Roles::default(),
            known: Known::Anonymous,
            address: end.map(|end| end.address),
            lease: None,
        };
        let Some(least) = least else {
            return match caller {
                Err(Refusal::Forged) => Err(Refusal::Forged),
                caller => Ok(caller.unwrap_or_else(|_| nobody())),
            };
        };
        let caller = caller?;
        if caller.may(least) {
            return Ok(caller);
        }
        if !caller.is_known() {
            return Err(unknown());
        }
        let Caller { name, roles, .. } = caller;
        Err(Refusal::Forbidden { least, name, roles })
    }

    /// A token beats a session, that a certificate, that a proxy's word; one that is wrong is an error, and not as if there
    /// were none.
    fn caller(
        &self,
        call: Call<'_>,
        end: Option<&RemoteEnd>,
        headers: &HeaderMap,
    ) -> Result<Caller, Refusal> {
        let address = end.map(|end| end.address);
        if self.strangers == Strangers::Unasked {
            return Ok(Caller { address, ..Caller::unasked() });
        }
        if end.is_some_and(RemoteEnd::is_over) {
            return Err(refused("the certificate of this connection no longer passes; connect again"));
        }
        if let Some(token) = bearer(headers)? {
            return self.bearer(token, end).map(|(caller, _)| caller);
        }
        if let Some(id) = session(headers) {
            let over = || refused("the session is over; sign in again");
            let caller = match self.sessions.basis(id, Instant::now()).ok_or_else(over)? {
                Basis::Token(token) => self.holder(token, end),
                Basis::Jwt(caller) => Some(Caller { address, ..caller }).filter(|caller| self.holds(caller)),
            };
            let caller = caller.ok_or_else(over)?;
            return if is_forged(call, id, headers) { Err(Refusal::Forged) } else { Ok(caller) };
        }
        if let Some(subject) = end.and_then(RemoteEnd::subject) {
            let subject = subject.as_ref().map_err(|reason| refused(reason))?;
            let (name, roles) = (subject.name.clone(), subject.roles);
            return Ok(Caller { name, roles, known: Known::Certificate, address, lease: None });
        }
        if let Some(told) = self.told_by_proxy(end, headers) {
            let (role, name) = told?;
            let (name, roles) = (name.to_owned(), role.into());
            return Ok(Caller { name, roles, known: Known::Proxy, address, lease: None });
        }
        let roles = if let Strangers::With(roles) = self.strangers { roles } else { Roles::default() };
        Ok(Caller { name: String::new(), roles, known: Known::Anonymous, address, lease: None })
    }

    /// Who brings a bearer token, and what a session with it rests on.
    pub(super) fn bearer(&self, token: &str, end: Option<&RemoteEnd>) -> Result<(Caller, Basis), Refusal> {
        let hash = hash_of(token);
        if let Some(caller) = self.holder(hash, end) {
            return Ok((caller, Basis::Token(hash)));
        }
        if self.identity.jwt_jwks.is_empty() || !jwt::looks_like_one(token) {
            return Err(refused("this token is not known; ask an operator for another"));
        }
        let current = self.current.load();
        let told = jwt::told_by(token, &current.keys, &self.identity).map_err(|error| {
            if error == jwt::NotTaken::UnknownKey {
                self.keys.want();
            }
            refused(&error.to_string())
        })?;
        let (Told { name, roles, lease }, address) = (told, end.map(|end| end.address));
        let caller = Caller { name, roles, known: Known::Jwt, address, lease: Some(lease) };
        Ok((caller.clone(), Basis::Jwt(caller)))
    }

    /// Whether what told of a caller still counts: the token's time is not over, and its key is still the issuer's.
    #[must_use]
    pub fn holds(&self, caller: &Caller) -> bool {
        caller.lease.as_ref().is_none_or(|lease| match caller.known {
            Known::Oidc => self.flows.holds(lease, now_s()),
            _ => lease.holds(&self.current.load().keys, now_s()),
        })
    }

    pub(super) fn identity(&self) -> &IdentityConfig {
        &self.identity
    }

    pub(super) fn key_source(&self) -> &jwt::Source {
        &self.keys
    }

    fn holder(&self, token: TokenHash, end: Option<&RemoteEnd>) -> Option<Caller> {
        let current = self.current.load();
        let holder = current.tokens.holder(&token)?;
        end.inspect(|end| end.note(token));
        let address = end.map(|end| end.address);
        let (name, roles) = (holder.name.clone(), holder.roles);
        Some(Caller { name, roles, known: Known::Token, address, lease: None })
    }

    /// Whether the address of a connection stands for those who call by it: not where nobody is asked, and not a proxy's.
    #[must_use]
    pub fn counts(&self, end: Option<&RemoteEnd>) -> bool {
        let proxy = !self.identity.proxy_header.is_empty() && end.is_some_and(RemoteEnd::is_local);
        self.strangers != Strangers::Unasked && !proxy
    }

    /// What a proxy on this machine says; anybody else's header says nothing.
    fn told_by_proxy<'a>(
        &self,
        end: Option<&RemoteEnd>,
        headers: &'a HeaderMap,
    ) -> Option<Result<(Role, &'a str), Refusal>> {
        let header = &self.identity.proxy_header;
        if header.is_empty() || !end.is_some_and(RemoteEnd::is_local) {
            return None;
        }
        let mut values = headers.get_all(header.as_str()).iter();
        let value = values.next()?;
        let only = values.next().is_none();
        let told = value.to_str().ok().and_then(role_and_name).filter(|_| only);
        Some(told.ok_or_else(|| refused("the proxy's header is not ROLE/NAME, or there are several")))
    }
}

fn unknown() -> Refusal {
    refused(
        "who asks is not known; show a client certificate, or a token as `authorization: Bearer TOKEN` (the command takes \
         --cert and --key, or --token)",
    )
}
