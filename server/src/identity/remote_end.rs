//! The other end of a connection: where it is, and the certificate it showed.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use rustls::pki_types::CertificateDer;
use tokio::sync::oneshot;

use super::certificate::{Subject, not_after, subject};
use super::tls::{Identified, now_s};
use super::tokens::TokenHash;
use crate::listen::RemoteAddress;

/// Tokens of one connection that are remembered; a proxy in front may bring many.
const REMEMBERED: usize = 256;

/// Resolves when a connection is to end because its identity no longer holds.
pub type Closing = oneshot::Receiver<()>;

/// The other end of a connection.
pub struct RemoteEnd {
    /// Where it is.
    pub address: RemoteAddress,
    /// Whether TLS runs on the connection.
    pub encrypted: bool,
    certificate: Option<Presented>,
    /// By which requests of this connection were known.
    tokens: Mutex<Vec<TokenHash>>,
    over: AtomicBool,
    close: Mutex<Option<oneshot::Sender<()>>>,
}

/// A certificate that was checked when the connection began.
struct Presented {
    chain: Vec<CertificateDer<'static>>,
    subject: Result<Subject, String>,
    not_after: i64,
}

impl RemoteEnd {
    /// Of a connection with this certificate chain, its own first; none without.
    pub(super) fn new(
        address: RemoteAddress,
        encrypted: bool,
        chain: Option<&[CertificateDer<'_>]>,
        trust_domain: &str,
    ) -> (Self, Closing) {
        let certificate = chain.filter(|chain| !chain.is_empty()).map(|chain| Presented {
            subject: subject(&chain[0], trust_domain),
            not_after: chain.iter().map(|der| not_after(der).unwrap_or(0)).min().unwrap_or(0),
            chain: chain.iter().map(|der| der.clone().into_owned()).collect(),
        });
        let (close, closing) = oneshot::channel();
        let close = Mutex::new(Some(close));
        let (tokens, over) = (Mutex::default(), AtomicBool::new(false));
        (Self { address, encrypted, certificate, tokens, over, close }, closing)
    }

    /// Whether it is on this machine.
    pub(super) fn is_local(&self) -> bool {
        self.address.is_local()
    }

    /// Who its certificate is for; `None` without one.
    pub(super) fn subject(&self) -> Option<&Result<Subject, String>> {
        self.certificate.as_ref().map(|certificate| &certificate.subject)
    }

    /// Whether its identity no longer holds.
    pub(super) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
            || self.certificate.as_ref().is_some_and(|certificate| certificate.not_after <= now_s())
    }

    /// Notes by which token a request was known.
    pub(super) fn note(&self, token: TokenHash) {
        let mut tokens = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
        if !tokens.contains(&token) {
            if tokens.len() == REMEMBERED {
                tokens.remove(0);
            }
            tokens.push(token);
        }
    }

    /// Whether certificate and tokens would be taken now.
    pub(super) fn passes(&self, now: &Identified) -> bool {
        let tokens = self.tokens.lock().unwrap_or_else(PoisonError::into_inner);
        tokens.iter().all(|token| now.tokens.holder(token).is_some())
            && self.certificate.as_ref().is_none_or(|certificate| now.takes(&certificate.chain))
    }

    pub(super) fn end(&self) {
        self.over.store(true, Ordering::Relaxed);
        let close = self.close.lock().unwrap_or_else(PoisonError::into_inner).take();
        // A connection that is gone needs not be told.
        close.map(|close| close.send(()));
    }
}

/// All connections of both ports.
#[derive(Default)]
pub(super) struct RemoteEnds(Mutex<(u64, HashMap<u64, Weak<RemoteEnd>>)>);

/// A connection among the others, until it is dropped.
pub struct Entry {
    end: Arc<RemoteEnd>,
    id: u64,
    ends: Arc<RemoteEnds>,
}

impl Entry {
    /// The other end.
    #[must_use]
    pub fn end(&self) -> &Arc<RemoteEnd> {
        &self.end
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        self.ends.locked().1.remove(&self.id);
    }
}

impl RemoteEnds {
    fn locked(&self) -> std::sync::MutexGuard<'_, (u64, HashMap<u64, Weak<RemoteEnd>>)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn enter(self: &Arc<Self>, end: RemoteEnd) -> Entry {
        let end = Arc::new(end);
        let mut known = self.locked();
        known.0 += 1;
        let id = known.0;
        known.1.insert(id, Arc::downgrade(&end));
        Entry { end, id, ends: Arc::clone(self) }
    }

    /// Ends the connections whose identity does not hold any more; with `all`, those whose time is not over are held against
    /// what counts now, too. Returns how many.
    pub(super) fn sweep(&self, now: &Identified, all: bool) -> usize {
        let ends: Vec<_> = self.locked().1.values().filter_map(Weak::upgrade).collect();
        let gone = |end: &&Arc<RemoteEnd>| end.is_over() || (all && !end.passes(now));
        ends.iter().filter(gone).map(|end| end.end()).count()
    }
}
