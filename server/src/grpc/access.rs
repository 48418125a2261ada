//! Who calls, and whether they may. The caller goes with the request to its handler.

use std::future::{Future, ready};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::http::{Extensions, Request, Response};
use tonic::body::Body;
use tonic::{Code, Status};
use tower::{Layer, Service};

use super::status;
use crate::identity::access::Call;
use crate::identity::{Caller, Gate, Peer, Refusal};

/// Lets through only what the caller may call.
#[derive(Clone)]
pub struct AccessLayer(Arc<Gate>);

impl AccessLayer {
    /// As the gate says.
    #[must_use]
    pub fn new(gate: Arc<Gate>) -> Self {
        Self(gate)
    }
}

impl<S> Layer<S> for AccessLayer {
    type Service = Admitting<S>;

    fn layer(&self, inner: S) -> Admitting<S> {
        Admitting { gate: Arc::clone(&self.0), inner }
    }
}

/// A service whose requests come from callers that may call it.
#[derive(Clone)]
pub struct Admitting<S> {
    gate: Arc<Gate>,
    inner: S,
}

impl<S, B> Service<Request<B>> for Admitting<S>
where
    S: Service<Request<B>, Response = Response<Body>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Response<Body>, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<B>) -> Self::Future {
        let peer = request.extensions().get::<Arc<Peer>>().map(Arc::as_ref);
        match self.gate.admit(Call::Rpc(request.uri().path()), peer, request.headers()) {
            Ok(caller) => {
                request.extensions_mut().insert(Arc::new(caller));
                Box::pin(self.inner.call(request))
            }
            Err(refusal) => Box::pin(ready(Ok(refused(&refusal).into_http()))),
        }
    }
}

fn refused(refusal: &Refusal) -> Status {
    let reason = match refusal {
        // As if it did not exist: for the caller it does not.
        Refusal::NotServed => return Status::unimplemented(refusal.to_string()),
        Refusal::Unauthenticated(_) => (Code::Unauthenticated, "UNAUTHENTICATED"),
        Refusal::Forbidden { .. } => (Code::PermissionDenied, "ROLE_MISSING"),
    };
    status::denied(reason.0, reason.1, refusal)
}

/// Who makes a call.
///
/// # Errors
/// When the call did not come through the door, which is a defect.
pub(super) fn caller(extensions: &Extensions) -> Result<Arc<Caller>, Status> {
    extensions
        .get::<Arc<Caller>>()
        .cloned()
        .ok_or_else(|| status::failed("nobody asked who calls; this is a defect"))
}
