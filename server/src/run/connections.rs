//! Which connections are let in, and for how long they may say nothing.

mod door;
mod frames;

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::time::{Sleep, sleep};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::Connected;

use crate::identity::{Closing, Entry, Peer};
use crate::sparse;
pub(super) use door::Door;
use door::{Opened, Stream};
use frames::FrameCount;

/// How long accepting rests when the system has no more descriptors.
const REST: Duration = Duration::from_millis(50);

/// Takes connections off a port, a bounded number at a time.
pub(super) struct Acceptor {
    listener: TcpListener,
    permits: Arc<Semaphore>,
    handshake: Duration,
    door: Door,
}

impl Acceptor {
    pub(super) fn new(listener: TcpListener, connections: usize, handshake: Duration, door: Door) -> Self {
        Self { listener, permits: Arc::new(Semaphore::new(connections)), handshake, door }
    }

    /// The connections from now on, until the receiver is dropped.
    pub(super) fn open(self) -> ReceiverStream<Connection> {
        let (sender, receiver) = mpsc::channel(1);
        tokio::spawn(async move {
            loop {
                tokio::select! {
                    () = self.next(&sender) => {}
                    () = sender.closed() => return,
                }
            }
        });
        ReceiverStream::new(receiver)
    }

    /// Lets the next connection in that there is a permit for; others are closed at once. TLS keeps nobody else waiting.
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
            let Ok(permit) = self.permits.clone().try_acquire_owned() else {
                tracing::debug!("closed a connection: too many");
                continue;
            };
            // Small messages go out at once. A socket that refuses the option works without.
            let _ = stream.set_nodelay(true);
            let mut deadline = Box::pin(sleep(self.handshake));
            let (door, sender) = (self.door.clone(), sender.clone());
            tokio::spawn(async move {
                let opened = tokio::select! {
                    opened = door.open(stream, address) => opened,
                    () = &mut deadline => None,
                };
                let Some(Opened { stream, entry, closing }) = opened else { return };
                let first_request = FirstRequest { came: Arc::default(), entry: Arc::new(entry) };
                let frames = FrameCount::new(Instant::now());
                let connection = Connection {
                    stream,
                    deadline,
                    closing,
                    told_to_go: false,
                    first_request,
                    frames,
                    _permit: permit,
                };
                // Nobody takes it once the port is closed.
                let _ = sender.send(connection).await;
            });
            return;
        }
    }
}

/// Whether a connection's first request is still awaited, and whose connection it is.
#[derive(Clone)]
pub(super) struct FirstRequest {
    came: Arc<AtomicBool>,
    entry: Arc<Entry>,
}

impl FirstRequest {
    /// A request came.
    pub(super) fn came(&self) {
        self.came.store(true, Ordering::Relaxed);
    }

    /// The other end of its connection.
    pub(super) fn peer(&self) -> &Arc<Peer> {
        self.entry.peer()
    }

    fn is_over(&self) -> bool {
        self.came.load(Ordering::Relaxed)
    }
}

/// A connection that ends when its first request does not come in time, whatever else it sends, and when it sends frames
/// without end that carry none.
pub(super) struct Connection {
    stream: Stream,
    deadline: Pin<Box<Sleep>>,
    closing: Closing,
    told_to_go: bool,
    pub(super) first_request: FirstRequest,
    frames: FrameCount,
    _permit: OwnedSemaphorePermit,
}

impl Connection {
    fn note_sent(&mut self, written: &Poll<io::Result<usize>>) {
        if let Poll::Ready(Ok(bytes)) = written {
            self.frames.sent(*bytes);
        }
    }
}

impl Connected for Connection {
    type ConnectInfo = FirstRequest;

    fn connect_info(&self) -> FirstRequest {
        self.first_request.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if !self.first_request.is_over() && self.deadline.as_mut().poll(cx).is_ready() {
            // A request that came in the same moment is served.
            if !self.first_request.is_over() {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
        }
        // Its certificate was revoked, or its token: whoever it is connects again, or not.
        if !self.told_to_go {
            self.told_to_go = Pin::new(&mut self.closing).poll(cx).is_ready();
        }
        if self.told_to_go {
            return Poll::Ready(Err(io::ErrorKind::ConnectionAborted.into()));
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
        written
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, bytes);
        self.note_sent(&written);
        written
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
