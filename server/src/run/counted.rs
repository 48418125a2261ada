//! Each gRPC call is counted, with its code, its time and, where it was refused, the reason.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Instant;

use axum::http::{HeaderMap, Request, Response};
use bytes::Bytes;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tonic::body::Body;
use tonic::{Code, Status};
use tonic_types::StatusExt;
use tower::{Layer, Service};

use super::calls::WITHOUT_END;
use crate::export;
use crate::identity::access::{Call, TABLE};
use crate::metrics::{Metrics, ReasonLabel};
use crate::rpc_code::word;
use crate::trace::CallSpan;

/// Counts calls.
#[derive(Clone)]
pub(super) struct CountedLayer(pub(super) Arc<Metrics>);

impl<S> Layer<S> for CountedLayer {
    type Service = Counted<S>;

    fn layer(&self, inner: S) -> Counted<S> {
        Counted { metrics: Arc::clone(&self.0), inner }
    }
}

/// A service whose calls are counted.
#[derive(Clone)]
pub(super) struct Counted<S> {
    metrics: Arc<Metrics>,
    inner: S,
}

impl<S> Service<Request<Body>> for Counted<S>
where
    S: Service<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Response<Body>, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        // Here, so that a caller who goes before there is an answer is counted, too.
        let mut call = CountedCall {
            metrics: Arc::clone(&self.metrics),
            method: known(request.uri().path()),
            began: Instant::now(),
            took: None,
            over: false,
            span: request.extensions().get().map(|CallSpan(span)| span.clone()),
        };
        let answer = self.inner.call(request);
        Box::pin(async move {
            let answer = answer.await?;
            call.head(answer.headers());
            Ok(answer.map(|inner| Body::new(CountedBody { inner, call })))
        })
    }
}

/// The method as the one table of calls names it: callers may write anything there.
fn known(path: &str) -> &'static str {
    let method = TABLE.iter().find_map(|(call, _)| match call {
        Call::Rpc(method) if *method == path => Some(*method),
        _ => None,
    });
    method.unwrap_or("unknown")
}

/// A call that is counted when it is over.
struct CountedCall {
    metrics: Arc<Metrics>,
    method: &'static str,
    began: Instant,
    /// How long it took, where that is known before its end.
    took: Option<std::time::Duration>,
    over: bool,
    /// Its span, which ends with it.
    span: Option<tracing::Span>,
}

impl CountedCall {
    /// The answer begins; what is refused at once ends with it.
    fn head(&mut self, headers: &HeaderMap) {
        if WITHOUT_END.contains(&self.method) {
            self.took = Some(self.began.elapsed());
        }
        if headers.contains_key("grpc-status") {
            self.ended(headers);
        }
    }

    fn ended(&mut self, trailers: &HeaderMap) {
        let Some(status) = Status::from_header_map(trailers) else { return };
        let reason = status.get_details_error_info().map(|info| info.reason);
        if let Some(reason) = reason.filter(|_| status.code() != Code::Ok) {
            self.metrics.refusals.get_or_create(&ReasonLabel { reason }).inc();
        }
        self.count(word(status.code()));
    }

    fn count(&mut self, code: &'static str) {
        if !std::mem::replace(&mut self.over, true) {
            if let Some(span) = self.span.take() {
                export::note(&span, "rpc.grpc.status_code", code);
                if code != word(Code::Ok) {
                    export::failed(&span, code);
                }
            }
            self.metrics.count_rpc(self.method, code, self.took.unwrap_or_else(|| self.began.elapsed()));
        }
    }
}

impl Drop for CountedCall {
    /// The caller went away before the end.
    fn drop(&mut self) {
        self.count(word(Code::Cancelled));
    }
}

struct CountedBody {
    inner: Body,
    call: CountedCall,
}

impl HttpBody for CountedBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let frame = Pin::new(&mut self.inner).poll_frame(context);
        match &frame {
            Poll::Ready(Some(Ok(frame))) => {
                if let Some(trailers) = frame.trailers_ref() {
                    self.call.ended(trailers);
                }
            }
            Poll::Ready(Some(Err(status))) => self.call.count(word(status.code())),
            // Every answer of gRPC has trailers, or a head that says how it ended.
            Poll::Ready(None) | Poll::Pending => {}
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: labels that callers choose, so that the metrics grow without end.
    #[test]
    fn what_nobody_serves_is_one_method() {
        assert_eq!(known("/echofix.v1.MappingService/Upload"), "/echofix.v1.MappingService/Upload");
        for path in ["/echofix.v1.MappingService/Upload1", "/echofix.v1.Any/Thing", "/", ""] {
            assert_eq!(known(path), "unknown");
        }
    }
}
