//! What holds for every call of the vehicles' port: its connection is in use, its body comes at a least pace, and answers
//! without an end end with the service.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::http::{HeaderMap, Request, Response};
use bytes::Bytes;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::sync::watch;
use tonic::Status;
use tonic::body::Body;
use tower::{Layer, Service};

use super::connections::{InUse, Origin};
use super::ended;
use crate::grpc::status;
use crate::pace::{Pace, PacedBody, TooSlow};

/// Bytes of a stream that may be under way before they are read. Those of one that is refused on its headers are sent for nothing,
/// so there are no more than every caller may send before it has heard of the service's window.
pub(super) const STREAM_WINDOW: u32 = (64 << 10) - 1;

/// Calls whose messages come when the caller has some.
const AT_LEISURE: [&str; 2] = [
    "/echofix.v1.LocalizationService/LocalizeStream",
    "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
];
/// Tells who watches whether the service serves.
const WATCH: &str = "/grpc.health.v1.Health/Watch";
/// Calls whose answers have no end of their own.
pub(super) const WITHOUT_END: [&str; 3] = [AT_LEISURE[0], AT_LEISURE[1], WATCH];
/// How long a watcher has to be told that the service does not serve, before its answer ends.
const LAST_WORD: Duration = Duration::from_millis(300);
/// When a caller whose stream was ended should come again: to whatever serves by then.
const RETRY: Duration = Duration::from_secs(1);

/// Puts calls into a frame.
#[derive(Clone)]
pub(super) struct CallsLayer {
    pace: Pace,
    ending: watch::Receiver<bool>,
}

impl CallsLayer {
    /// Bodies come at a pace, until `ending` turns true.
    pub(super) fn new(pace: Pace, ending: watch::Receiver<bool>) -> Self {
        Self { pace, ending }
    }
}

impl<S> Layer<S> for CallsLayer {
    type Service = Calls<S>;

    fn layer(&self, inner: S) -> Calls<S> {
        Calls { frame: self.clone(), inner }
    }
}

/// A service whose calls are in a frame.
#[derive(Clone)]
pub(super) struct Calls<S> {
    frame: CallsLayer,
    inner: S,
}

impl<S> Service<Request<Body>> for Calls<S>
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
        let CallsLayer { pace, ending } = self.frame.clone();
        let connection = request.extensions().get::<Origin>().cloned();
        let held = connection.as_ref().map(|origin| origin.used.begin());
        let path = request.uri().path();
        let pace = (!AT_LEISURE.contains(&path)).then_some(pace);
        let last_word = if path == WATCH { LAST_WORD } else { Duration::ZERO };
        let end = WITHOUT_END.contains(&path).then(|| ended_after(ending.clone(), last_word));
        let mut request = request.map(|body| {
            Body::new(PacedBody::new(body, pace, ending).within(STREAM_WINDOW as usize).told(too_slow))
        });
        if let Some(connection) = connection {
            request.extensions_mut().insert(connection.used.peer());
            request.extensions_mut().insert(Arc::clone(connection.end()));
        }
        let answer = self.inner.call(request);
        Box::pin(async move { Ok(answer.await?.map(|body| Body::new(AnswerBody::new(body, held, end)))) })
    }
}

/// Resolves so long after the service begins to end.
fn ended_after(ending: watch::Receiver<bool>, wait: Duration) -> End {
    Box::pin(async move {
        ended(ending).await;
        tokio::time::sleep(wait).await;
    })
}

type End = Pin<Box<dyn Future<Output = ()> + Send>>;

fn too_slow(error: TooSlow) -> crate::pace::BodyError {
    Status::deadline_exceeded(error.to_string()).into()
}

/// The body of an answer. While it is there its connection is in use.
struct AnswerBody {
    inner: Body,
    /// Where the answer has no end of its own: when the service ends.
    end: Option<End>,
    over: bool,
    _held: Option<InUse>,
}

impl AnswerBody {
    fn new(inner: Body, held: Option<InUse>, end: Option<End>) -> Self {
        let end = end.filter(|_| !inner.is_end_stream());
        Self { inner, end, over: false, _held: held }
    }
}

impl HttpBody for AnswerBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if self.over {
            return Poll::Ready(None);
        }
        if let Some(end) = &mut self.end
            && end.as_mut().poll(context).is_ready()
        {
            self.over = true;
            // What it answers from goes with it: the caller's messages, and permits.
            self.inner = Body::empty();
            let mut trailers = HeaderMap::new();
            let told = status::unavailable("the service ends; connect again", RETRY);
            return Poll::Ready(Some(told.add_header(&mut trailers).map(|()| Frame::trailers(trailers))));
        }
        Pin::new(&mut self.inner).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.over || self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}
