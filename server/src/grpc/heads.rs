//! Calls that are looked at before anything of their bodies is read, and answered there where they are not let in.

use std::future::{Future, ready};
use std::pin::Pin;
use std::task::{Context, Poll};

use axum::http::{Request, Response};
use tonic::Status;
use tonic::body::Body;
use tower::{Layer, Service};

/// Looks at the head of a call.
pub trait Look: Clone {
    /// Lets it in, with what its handler is to know among its extensions.
    ///
    /// # Errors
    /// What the caller is told instead.
    fn look<B>(&self, request: &mut Request<B>) -> Result<(), Status>;
}

/// Lets in what somebody has looked at.
#[derive(Clone)]
pub struct HeadsLayer<L>(pub L);

impl<L: Look, S> Layer<S> for HeadsLayer<L> {
    type Service = Heads<L, S>;

    fn layer(&self, inner: S) -> Heads<L, S> {
        Heads { look: self.0.clone(), inner }
    }
}

/// A service whose calls were looked at.
#[derive(Clone)]
pub struct Heads<L, S> {
    look: L,
    inner: S,
}

impl<L, S, B> Service<Request<B>> for Heads<L, S>
where
    L: Look,
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
        match self.look.look(&mut request) {
            Ok(()) => Box::pin(self.inner.call(request)),
            Err(status) => Box::pin(ready(Ok(status.into_http()))),
        }
    }
}
