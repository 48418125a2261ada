//! Which connections are let in, and for how long they may say nothing.

mod door;
mod frames;
mod registry;

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use prometheus_client::metrics::counter::Counter;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::futures::OwnedNotified;
use tokio::sync::mpsc;
use tokio::time::{Sleep, sleep};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::Connected;

use super::listener::{Accepted, Listener};
use crate::config::LimitsConfig;
use crate::identity::{self, Closing};
use crate::metrics::{Metrics, PortLabel};
use crate::shares::Peer;
use crate::sparse;
pub(super) use door::Door;
use door::{Opened, Stream};
use frames::FrameCount;
pub(super) use registry::{ConnectionUse, InUse};
use registry::{Entry, Registry};

/// How long accepting rests when the system has no more descriptors.
const REST: Duration = Duration::from_millis(50);

/// Takes connections off a port, a bounded number at a time.
pub(super) struct Acceptor {
    listener: Listener,
    registry: Registry,
    turned_away: Counter,
    handshake: Duration,
    idle: Duration,
    door: Door,
}

impl Acceptor {
    pub(super) fn new(listener: Listener, limits: &LimitsConfig, door: Door, metrics: &Metrics) -> Self {
        let port = PortLabel { port: door.port().name() };
        let open = metrics.connections.get_or_create_owned(&port);
        let turned_away = metrics.connections_turned_away.get_or_create_owned(&port);
        let registry = Registry::new(limits.connections, limits.address_share).counted(open);
        Self { listener, registry, turned_away, handshake: limits.handshake(), idle: limits.idle(), door }
    }

    /// The connections from now on, until the receiver is dropped.
    pub(super) fn open(self) -> ReceiverStream<Connection> {
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(async move {
            loop {
                tokio::select! {
                    () = self.next(&sender) => {}
                    () = sender.closed() => break,
                }
            }
            self.registry.close_silent();
        });
        ReceiverStream::new(receiver)
    }

    /// Lets the next connection in that there is room for; others are closed at once. TLS keeps nobody else waiting.
    async fn next(&self, sender: &mpsc::Sender<Connection>) {
        loop {
            let (stream, address) = match self.listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    if let Some(left_out) = sparse::line("a connection could not be accepted") {
                        tracing::warn!(%error, left_out, "a connection could not be accepted");
                    }
                    sleep(REST).await;
                    continue;
                }
            };
            let now = Instant::now();
            let used = ConnectionUse::new(Peer::at(address.ip()), now);
            let Some(place) = self.registry.enter(&used, now) else {
                self.turned_away.inc();
                tracing::debug!("closed a connection: too many");
                continue;
            };
            if let Accepted::Tcp(stream) = &stream {
                // Small messages go out at once. A socket that refuses the option works without.
                let _ = stream.set_nodelay(true);
            }
            let mut deadline = Box::pin(sleep(self.handshake));
            let (door, sender, idle) = (self.door.clone(), sender.clone(), self.idle);
            tokio::spawn(async move {
                let opened = tokio::select! {
                    opened = door.open(stream, address) => opened,
                    () = &mut deadline => None,
                };
                let Some(Opened { stream, entry, closing }) = opened else { return };
                let frames = FrameCount::new(Instant::now());
                let making_room = Box::pin(used.closing());
                let origin = Origin { used, entry: Arc::new(entry) };
                let connection = Connection {
                    stream,
                    deadline,
                    closing,
                    told_to_go: false,
                    making_room,
                    idle,
                    origin,
                    frames,
                    _place: place,
                };
                // Nobody takes it once the port is closed.
                let _ = sender.send(connection).await;
            });
            return;
        }
    }
}

/// Where a call comes from: the use of its connection, and the other end of it.
#[derive(Clone)]
pub(super) struct Origin {
    pub(super) used: ConnectionUse,
    entry: Arc<identity::Entry>,
}

impl Origin {
    /// The other end of its connection.
    pub(super) fn end(&self) -> &Arc<identity::RemoteEnd> {
        self.entry.end()
    }
}

/// A connection that ends when its first request does not come in time, whatever else it sends, when it sends frames
/// without end that carry none, when it was idle for long, and when it has to make room for another.
pub(super) struct Connection {
    stream: Stream,
    /// Of the first request; then when idleness is looked at again.
    deadline: Pin<Box<Sleep>>,
    closing: Closing,
    told_to_go: bool,
    making_room: Pin<Box<OwnedNotified>>,
    idle: Duration,
    pub(super) origin: Origin,
    frames: FrameCount,
    _place: Entry,
}

impl Connection {
    /// Is its time over? `Some` with an error where it never was of use.
    fn is_over(&mut self, cx: &mut Context<'_>) -> Option<io::Result<()>> {
        if self.making_room.as_mut().poll(cx).is_ready() {
            return Some(Ok(()));
        }
        // Its certificate was revoked, or its token: whoever it is connects again, or not.
        if !self.told_to_go {
            self.told_to_go = Pin::new(&mut self.closing).poll(cx).is_ready();
        }
        if self.told_to_go {
            return Some(Err(io::ErrorKind::ConnectionAborted.into()));
        }
        while self.deadline.as_mut().poll(cx).is_ready() {
            // A request that came in the same moment is served.
            if !self.origin.used.was_requested() {
                return Some(Err(io::ErrorKind::TimedOut.into()));
            }
            let idle = self.origin.used.idle(Instant::now()).unwrap_or_default();
            if idle >= self.idle {
                return Some(Ok(()));
            }
            let again =
                tokio::time::Instant::now() + self.idle.saturating_sub(idle).max(Duration::from_millis(1));
            self.deadline.as_mut().reset(again);
        }
        None
    }

    /// A write that waits for a peer which takes nothing: nobody reads meanwhile, so its time is looked at here, too.
    fn unless_over<T>(&mut self, cx: &mut Context<'_>, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if written.is_pending() && self.is_over(cx).is_some() {
            return Poll::Ready(Err(io::ErrorKind::ConnectionAborted.into()));
        }
        written
    }

    fn note_sent(&mut self, written: &Poll<io::Result<usize>>) {
        if let Poll::Ready(Ok(bytes)) = written {
            self.frames.sent(*bytes);
        }
    }
}

impl Connected for Connection {
    type ConnectInfo = Origin;

    fn connect_info(&self) -> Origin {
        self.origin.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if let Some(over) = self.is_over(cx) {
            // Nothing more is read: the caller takes it for the end of the connection.
            return Poll::Ready(over);
        }
        let before = buf.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(cx, buf);
        if !self.frames.take(&buf.filled()[before..], Instant::now()) {
            if let Some(left_out) = sparse::line("a connection sends frames without end") {
                tracing::info!(
                    left_out,
                    "closed a connection: it sends frames without end that carry no request"
                );
            }
            return Poll::Ready(Err(io::ErrorKind::InvalidData.into()));
        }
        read
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.note_sent(&written);
        self.unless_over(cx, written)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let flushed = Pin::new(&mut self.stream).poll_flush(cx);
        self.unless_over(cx, flushed)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let shut = Pin::new(&mut self.stream).poll_shutdown(cx);
        self.unless_over(cx, shut)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, bytes);
        self.note_sent(&written);
        self.unless_over(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
