//! Every request has an id and a span: log lines that belong to it carry the id, on whichever thread they are written.
//!
//! The id is the caller's `x-request-id` where it is sane, else a fresh UUID; the answer names it. Spans hold the id and
//! the name of the call, and nothing that says who asked or where.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};

use axum::extract::MatchedPath;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Request, Response};
use tower::{Layer, Service};
use tracing::{Instrument, Span};
use uuid::Uuid;

use crate::export;
use crate::port::Port;

/// The header, and the gRPC metadata, that names a request.
pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// Characters of an id that a caller may choose, at most.
const MAX_ID: usize = 64;

/// Runs work in the span of the caller, wherever it runs.
pub(crate) fn in_current_span<T>(work: impl FnOnce() -> T) -> impl FnOnce() -> T {
    let span = Span::current();
    move || span.in_scope(work)
}

/// The caller's id of a request, or a new one.
fn request_id(headers: &HeaderMap) -> HeaderValue {
    let sane = |id: &&HeaderValue| {
        (1..=MAX_ID).contains(&id.len()) && id.as_bytes().iter().all(u8::is_ascii_graphic)
    };
    headers.get(REQUEST_ID).filter(sane).cloned().unwrap_or_else(|| {
        let fresh = Uuid::now_v7().to_string();
        // Hexadecimal digits and hyphens are a header value.
        HeaderValue::from_str(&fresh).unwrap_or_else(|_| HeaderValue::from_static("none"))
    })
}

impl Port {
    /// The call as its definition names it. What a caller may put into an address stays out: positions and ids do.
    pub fn call<B>(self, request: &Request<B>) -> &str {
        match self {
            Self::Grpc => {
                let path = request.uri().path();
                let ours = ["/echofix.v1.", "/grpc."].iter().any(|prefix| path.starts_with(prefix));
                let plain = path.bytes().all(|b| b.is_ascii_alphanumeric() || b"/._".contains(&b));
                if ours && plain && path.len() <= MAX_ID { path } else { "unknown" }
            }
            Self::Http => request.extensions().get::<MatchedPath>().map_or("unknown", MatchedPath::as_str),
        }
    }
}

/// A method that HTTP knows and this service may take; callers may write anything there.
pub(crate) fn usual_method(method: &Method) -> Option<&'static str> {
    ["GET", "HEAD", "POST", "DELETE", "OPTIONS"].into_iter().find(|usual| method == usual)
}

/// The span of a call, for those who find out something about it.
#[derive(Debug, Clone)]
pub(crate) struct CallSpan(pub(crate) Span);

/// Gives every request of a port its id and its span.
#[derive(Debug, Clone, Copy)]
pub struct RequestSpanLayer(Port);

impl RequestSpanLayer {
    /// For gRPC.
    #[must_use]
    pub fn grpc() -> Self {
        Self(Port::Grpc)
    }

    /// For HTTP. It must lie on the router, which knows the route that a request matches.
    #[must_use]
    pub fn http() -> Self {
        Self(Port::Http)
    }
}

impl<S> Layer<S> for RequestSpanLayer {
    type Service = RequestSpans<S>;

    fn layer(&self, inner: S) -> RequestSpans<S> {
        RequestSpans { port: self.0, inner }
    }
}

/// A service whose requests have ids and spans.
#[derive(Debug, Clone)]
pub struct RequestSpans<S> {
    port: Port,
    inner: S,
}

impl<S, B, R> Service<Request<B>> for RequestSpans<S>
where
    S: Service<Request<B>, Response = Response<R>>,
    S::Future: Send + 'static,
{
    type Response = Response<R>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Response<R>, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<B>) -> Self::Future {
        let id = request_id(request.headers());
        let (call, text) = (self.port.call(&request), id.to_str().unwrap_or_default());
        let span = match self.port {
            Port::Grpc => tracing::info_span!("rpc", call, request_id = text),
            Port::Http => tracing::info_span!("http", call, request_id = text),
        };
        export::continue_trace(&span, request.headers());
        let method = usual_method(request.method()).unwrap_or("_OTHER");
        export::note(&span, "http.request.method", method);
        request.extensions_mut().insert(CallSpan(span.clone()));
        let answer = span.in_scope(|| self.inner.call(request)).instrument(span.clone());
        let port = self.port;
        Box::pin(async move {
            let mut response = answer.await?;
            export::note(&span, "http.response.status_code", response.status().as_str());
            if port == Port::Http && response.status().is_server_error() {
                export::failed(&span, "server error");
            }
            response.headers_mut().insert(REQUEST_ID, id);
            Ok(response)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sane_id_is_kept_and_any_other_replaced() {
        let given = |id: &[u8]| {
            let headers = HeaderMap::from_iter([(REQUEST_ID, HeaderValue::from_bytes(id).unwrap())]);
            request_id(&headers).to_str().unwrap().to_owned()
        };
        for sane in ["a", "7f-3/x:~!", &"x".repeat(MAX_ID)] {
            assert_eq!(given(sane.as_bytes()), sane);
        }
        for bad in [&b""[..], b"two words", b"tab\there", "caf\u{e9}".as_bytes(), &[b'x'; MAX_ID + 1]] {
            let fresh = given(bad);
            assert!(Uuid::try_parse(&fresh).is_ok(), "{fresh}");
        }
        assert!(request_id(&HeaderMap::new()) != request_id(&HeaderMap::new()));
    }

    #[test]
    fn what_a_caller_puts_into_an_address_is_in_no_span() {
        let call = |path: &str| {
            let request = Request::builder().uri(path).body(()).unwrap();
            Port::Grpc.call(&request).to_owned()
        };
        assert_eq!(call("/echofix.v1.MappingService/Upload"), "/echofix.v1.MappingService/Upload");
        for other in
            ["/car-7", "/echofix.v1.MappingService/Upload%20car-7", &format!("/grpc.{}", "x".repeat(99))]
        {
            assert_eq!(call(other), "unknown");
        }
    }
}
