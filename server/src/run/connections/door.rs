//! The door of both ports: TLS, if it is configured, and the other end's certificate.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpStream, UnixStream};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

use crate::identity::{Closing, Entry, Gate};
use crate::listen::RemoteAddress;
use crate::port::Port;
use crate::run::listener::Accepted;
use crate::sparse;

/// Lets connections of a port in.
#[derive(Clone)]
pub(in crate::run) struct Door {
    gate: Arc<Gate>,
    port: Port,
}

/// A connection whose other end is known, as far as the connection tells.
pub(super) struct Opened {
    pub(super) stream: Stream,
    pub(super) entry: Entry,
    pub(super) closing: Closing,
}

impl Door {
    pub(in crate::run) fn new(gate: Arc<Gate>, port: Port) -> Self {
        Self { gate, port }
    }

    /// Whose door it is.
    pub(super) fn port(&self) -> Port {
        self.port
    }

    /// Encrypts the connection and takes it in; `None` when the other end cannot be let in.
    pub(super) async fn open(&self, stream: Accepted, address: RemoteAddress) -> Option<Opened> {
        let stream = match stream {
            // Nothing of it crosses a network, and proxies speak plainly there.
            Accepted::Unix(stream) => {
                let (entry, closing) = self.gate.enter(address, false, None);
                return Some(Opened { stream: Stream::Unix(stream), entry, closing });
            }
            Accepted::Tcp(stream) => stream,
        };
        // What counts when the connection begins; what changes meanwhile is held against it when it is known.
        let current = self.gate.current();
        let Some(config) = current.config(self.port) else {
            let (entry, closing) = self.gate.enter(address, false, None);
            return Some(Opened { stream: Stream::Plain(stream), entry, closing });
        };
        let stream = match TlsAcceptor::from(config).accept(stream).await {
            Ok(stream) => Box::new(stream),
            Err(error) => {
                if let Some(left_out) = sparse::line("a TLS handshake failed") {
                    tracing::info!(%error, left_out, "a TLS handshake failed");
                }
                return None;
            }
        };
        let (entry, closing) = self.gate.enter(address, true, stream.get_ref().1.peer_certificates());
        self.gate.recheck(&current, entry.end());
        Some(Opened { stream: Stream::Tls(stream), entry, closing })
    }
}

/// A connection's bytes.
pub(super) enum Stream {
    Plain(TcpStream),
    Unix(UnixStream),
    Tls(Box<TlsStream<TcpStream>>),
}

impl AsyncRead for Stream {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_read(cx, buf),
            Self::Unix(stream) => Pin::new(stream).poll_read(cx, buf),
            Self::Tls(stream) => Pin::new(stream).poll_read(cx, buf),
        }
    }
}

impl AsyncWrite for Stream {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_write(cx, bytes),
            Self::Unix(stream) => Pin::new(stream).poll_write(cx, bytes),
            Self::Tls(stream) => Pin::new(stream).poll_write(cx, bytes),
        }
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_flush(cx),
            Self::Unix(stream) => Pin::new(stream).poll_flush(cx),
            Self::Tls(stream) => Pin::new(stream).poll_flush(cx),
        }
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_shutdown(cx),
            Self::Unix(stream) => Pin::new(stream).poll_shutdown(cx),
            Self::Tls(stream) => Pin::new(stream).poll_shutdown(cx),
        }
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        match self.get_mut() {
            Self::Plain(stream) => Pin::new(stream).poll_write_vectored(cx, bytes),
            Self::Unix(stream) => Pin::new(stream).poll_write_vectored(cx, bytes),
            Self::Tls(stream) => Pin::new(stream).poll_write_vectored(cx, bytes),
        }
    }

    fn is_write_vectored(&self) -> bool {
        match self {
            Self::Plain(stream) => stream.is_write_vectored(),
            Self::Unix(stream) => stream.is_write_vectored(),
            Self::Tls(stream) => stream.is_write_vectored(),
        }
    }
}
