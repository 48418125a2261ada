//! One line a call, on either port, where the log takes the target `access`: what was asked and how it was answered, and as
//! what the caller was known. Never by which name, nor where anybody is.

use std::borrow::Cow;
use std::pin::Pin;
use std::sync::{Arc, OnceLock};
use std::task::{Context, Poll};
use std::time::Instant;

use axum::http::{HeaderMap, Request, Response};
use bytes::Buf;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tonic::Code;
use tower::{Layer, Service};

use crate::export;
use crate::identity::Roles;
use crate::port::Port;
use crate::rpc_code::word;
use crate::trace::{CallSpan, REQUEST_ID, usual_method};

/// The target of these lines, as the log's filter names it.
pub const TARGET: &str = "access";
const STATUS: &str = "grpc-status";

/// As what a caller is known: noted by whoever finds out, and told in the line.
#[derive(Debug, Clone, Default)]
pub struct NotedRoles(Arc<OnceLock<Roles>>);

impl NotedRoles {
    /// Notes it for a request that is told of.
    pub fn note<B>(request: &Request<B>, roles: Roles) {
        if let Some(CallSpan(span)) = request.extensions().get() {
            export::note(span, "echofix.role", roles);
        }
        if let Some(Self(noted)) = request.extensions().get() {
            // It is found out once.
            let _ = noted.set(roles);
        }
    }
}

/// Writes a line for each call of a port.
#[derive(Debug, Clone, Copy)]
pub struct AccessLogLayer(pub Port);

impl<S> Layer<S> for AccessLogLayer {
    type Service = AccessLog<S>;

    fn layer(&self, inner: S) -> AccessLog<S> {
        AccessLog { port: self.0, inner }
    }
}

/// A service whose calls are told.
#[derive(Debug, Clone)]
pub struct AccessLog<S> {
    port: Port,
    inner: S,
}

impl<S, B, R> Service<Request<B>> for AccessLog<S>
where
    S: Service<Request<B>, Response = Response<R>>,
    S::Future: Send + 'static,
    R: HttpBody,
{
    type Response = Response<ToldBody<R>>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: Request<B>) -> Self::Future {
        let mut line =
            tracing::enabled!(target: TARGET, tracing::Level::INFO).then(|| Line::of(self.port, &request));
        if let Some(line) = &line {
            request.extensions_mut().insert(line.roles.clone());
        }
        let answer = self.inner.call(request);
        Box::pin(async move {
            let response = answer.await?;
            if let Some(line) = &mut line {
                line.begins(&response);
            }
            Ok(response.map(|inner| ToldBody { inner: Box::pin(inner), line }))
        })
    }
}

/// A call, of which a line is written when it is over, however it ends.
struct Line {
    port: Port,
    began: Instant,
    call: String,
    method: Option<&'static str>,
    roles: NotedRoles,
    request_id: String,
    /// `None` until there is an answer.
    code: Option<Cow<'static, str>>,
    bytes: u64,
    whole: bool,
}

impl Line {
    fn of<B>(port: Port, request: &Request<B>) -> Self {
        Self {
            port,
            began: Instant::now(),
            call: port.call(request).to_owned(),
            method: usual_method(request.method()).filter(|_| port == Port::Http),
            roles: NotedRoles::default(),
            request_id: String::new(),
            code: None,
            bytes: 0,
            whole: false,
        }
    }

    fn begins<R>(&mut self, response: &Response<R>) {
        let id = response.headers().get(REQUEST_ID).and_then(|id| id.to_str().ok());
        id.unwrap_or_default().clone_into(&mut self.request_id);
        self.code = match self.port {
            Port::Http => Some(response.status().as_str().to_owned().into()),
            Port::Grpc => code(response.headers()).map(Cow::Borrowed),
        };
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        let Self { port, call, method, request_id, bytes, whole, .. } = self;
        let ms = self.began.elapsed().as_secs_f64() * 1000.0;
        let ms = (ms * 10.0).round() / 10.0;
        let code = self.code.as_deref().unwrap_or("CANCELLED");
        let role = self.roles.0.get().map(ToString::to_string).filter(|roles| !roles.is_empty());
        let role = role.as_deref().unwrap_or("none");
        let port = port.name();
        tracing::info!(target: TARGET, port, method, call = &**call, code, ms, bytes, whole, request_id = &**request_id, role, "answered");
    }
}

/// The code of gRPC, where headers or trailers tell it.
fn code(headers: &HeaderMap) -> Option<&'static str> {
    Some(word(Code::from_bytes(headers.get(STATUS)?.as_bytes())))
}

/// The body of an answer, which is counted.
pub struct ToldBody<R> {
    inner: Pin<Box<R>>,
    line: Option<Line>,
}

impl<R: HttpBody> HttpBody for ToldBody<R> {
    type Data = R::Data;
    type Error = R::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<R::Data>, R::Error>>> {
        let polled = self.inner.as_mut().poll_frame(context);
        let ended = self.inner.is_end_stream();
        if let (Some(line), Poll::Ready(frame)) = (&mut self.line, &polled) {
            line.whole |= ended || frame.is_none();
            if let Some(Ok(frame)) = frame {
                line.bytes += frame.data_ref().map_or(0, |data| data.remaining() as u64);
                if let Some(trailers) = frame.trailers_ref() {
                    line.whole = true;
                    line.code = code(trailers).map(Cow::Borrowed).or(line.code.take());
                }
            }
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

impl<R> Drop for ToldBody<R> {
    fn drop(&mut self) {
        // An answer without a body ends before anybody asks for a part of it.
        if let Some(line) = &mut self.line {
            line.whole |= line.bytes == 0 && line.code.is_some();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_written_as_their_definition_does() {
        let told = |text: &'static str| {
            code(&HeaderMap::from_iter([(
                axum::http::HeaderName::from_static(STATUS),
                text.parse().unwrap(),
            )]))
            .unwrap()
        };
        assert_eq!((told("0"), told("3"), told("16")), ("OK", "INVALID_ARGUMENT", "UNAUTHENTICATED"));
        assert_eq!(code(&HeaderMap::new()), None);
    }
}
