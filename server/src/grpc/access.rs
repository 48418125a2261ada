//! Who calls, and whether they may. The caller goes with the request to its handler.

use std::sync::Arc;
use std::time::Duration;

use axum::http::{Extensions, Request};
use tonic::{Code, Status};

use super::heads::Look;
use super::status;
use crate::access_log::NotedRoles;
use crate::identity::access::Call;
use crate::identity::{Caller, Gate, Rated, Rates, Refusal, RemoteEnd};

/// Lets through only what the caller may call.
#[derive(Clone)]
pub struct Access {
    gate: Arc<Gate>,
    rates: Arc<Rates>,
}

impl Look for Access {
    fn look<B>(&self, request: &mut Request<B>) -> Result<(), Status> {
        let caller = Arc::new(self.admit(request)?);
        request.extensions_mut().insert(Counted {
            caller,
            gate: Arc::clone(&self.gate),
            rates: Arc::clone(&self.rates),
        });
        Ok(())
    }
}

impl Access {
    /// As the gate says, and no oftener than the rates do.
    #[must_use]
    pub fn new(gate: Arc<Gate>, rates: Arc<Rates>) -> Self {
        Self { gate, rates }
    }

    fn admit<B>(&self, request: &Request<B>) -> Result<Caller, Status> {
        let (path, peer) =
            (request.uri().path(), request.extensions().get::<Arc<RemoteEnd>>().map(Arc::as_ref));
        let caller = self.gate.admit(Call::Rpc(path), peer, request.headers());
        let roles = match &caller {
            Ok(Caller { roles, .. }) | Err(Refusal::Forbidden { roles, .. }) => Some(*roles),
            Err(_) => None,
        };
        if let Some(roles) = roles {
            NotedRoles::note(request, roles);
        }
        let caller = caller.map_err(|refusal| refused(&refusal))?;
        let rated = match path {
            "/echofix.v1.LocalizationService/Localize" => Some(Rated::Localize),
            "/echofix.v1.MappingService/Upload" => Some(Rated::Upload),
            _ => None,
        };
        rated.map_or(Ok(()), |what| self.rates.count(what, &caller)).map_err(too_often)?;
        Ok(caller)
    }
}

/// Who makes a call, and what counts how often.
#[derive(Clone)]
pub(super) struct Counted {
    pub(super) caller: Arc<Caller>,
    gate: Arc<Gate>,
    rates: Arc<Rates>,
}

impl Counted {
    /// Counts one more for the caller: of a stream, whose messages come after it was let in.
    ///
    /// # Errors
    /// When it was too many, or what told of the caller no longer counts.
    pub(super) fn count(&self, what: Rated) -> Result<(), Status> {
        if !self.gate.holds(&self.caller) {
            let over = "the token of this stream has expired, or its key counts no longer; connect again with another";
            return Err(refused(&Refusal::Unauthenticated(over.to_owned())));
        }
        self.rates.count(what, &self.caller).map_err(too_often)
    }

    /// Counts an upload for the contributor that the caller vouches for.
    pub(super) fn count_for(&self, contributor: &str) -> Result<(), Status> {
        if contributor == self.caller.name || !self.caller.is_known() {
            return Ok(());
        }
        self.rates.count_for(Rated::Upload, contributor).map_err(too_often)
    }
}

fn too_often(wait: Duration) -> Status {
    status::overloaded("this caller asks too often", wait)
}

fn refused(refusal: &Refusal) -> Status {
    let reason = match refusal {
        // As if it did not exist: for the caller it does not.
        Refusal::NotServed => return Status::unimplemented(refusal.to_string()),
        Refusal::Unauthenticated(_) => (Code::Unauthenticated, "UNAUTHENTICATED"),
        Refusal::Forged => (Code::PermissionDenied, "FORGED"),
        Refusal::Forbidden { .. } => (Code::PermissionDenied, "ROLE_MISSING"),
    };
    status::denied(reason.0, reason.1, refusal)
}

/// Who makes a call.
///
/// # Errors
/// When the call did not come through the door, which is a defect.
pub(super) fn caller(extensions: &Extensions) -> Result<Counted, Status> {
    extensions
        .get::<Counted>()
        .cloned()
        .ok_or_else(|| status::failed("nobody asked who calls; this is a defect"))
}
