//! A request that no slot could take is refused on its headers: its body is neither unpacked nor decoded.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::http::{Request, Response};
use tonic::body::Body;
use tower::{Layer, Service};

use super::localize::turned_away;
use crate::locating::Locator;
use crate::metrics::Metrics;

/// The call whose work is bounded by slots.
const LOCALIZE: &str = "/echofix.v1.LocalizationService/Localize";

/// Looks at the slots before anything of a request is read.
#[derive(Clone)]
pub struct AdmissionLayer {
    locator: Arc<Locator>,
    metrics: Arc<Metrics>,
}

impl AdmissionLayer {
    /// For requests that a locator answers; refusals are counted in `metrics`.
    #[must_use]
    pub fn new(locator: Arc<Locator>, metrics: Arc<Metrics>) -> Self {
        Self { locator, metrics }
    }
}

impl<S> Layer<S> for AdmissionLayer {
    type Service = Admission<S>;

    fn layer(&self, inner: S) -> Admission<S> {
        Admission { door: self.clone(), inner }
    }
}

/// A service whose requests are admitted first.
#[derive(Clone)]
pub struct Admission<S> {
    door: AdmissionLayer,
    inner: S,
}

impl<S, B> Service<Request<B>> for Admission<S>
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
        if request.uri().path() == LOCALIZE {
            match self.door.locator.expect() {
                Ok(arriving) => drop(request.extensions_mut().insert(Arc::new(arriving))),
                Err(refusal) => {
                    let refused = turned_away(&self.door.metrics, &refusal).into_http();
                    return Box::pin(std::future::ready(Ok(refused)));
                }
            }
        }
        Box::pin(self.inner.call(request))
    }
}
