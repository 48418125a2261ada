//! A way to the service that counts the bytes on it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};

use crate::service::Service;

/// Forwards bytes and counts them: all that is on the wire but TCP's own headers.
pub struct Wiretap {
    /// `http://host:port`, instead of the service's for vehicles.
    pub grpc: String,
    bytes: Arc<AtomicU64>,
}

impl Wiretap {
    /// Taps the way to a service's port for vehicles, as long as the runtime runs.
    pub async fn on(service: &Service) -> Self {
        let to = service.grpc.trim_start_matches("http://").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port is free");
        let grpc = format!("http://{}", listener.local_addr().expect("it is bound"));
        let bytes = Arc::new(AtomicU64::new(0));
        let counted = bytes.clone();
        tokio::spawn(async move {
            while let Ok((caller, _)) = listener.accept().await {
                let Ok(service) = TcpStream::connect(&to).await else { continue };
                let ((from_caller, to_caller), (from_service, to_service)) =
                    (caller.into_split(), service.into_split());
                tokio::spawn(hand_on(from_caller, to_service, counted.clone()));
                tokio::spawn(hand_on(from_service, to_caller, counted.clone()));
            }
        });
        Self { grpc, bytes }
    }

    /// Bytes both ways since this was asked last.
    pub fn taken(&self) -> u64 {
        self.bytes.swap(0, Ordering::Relaxed)
    }
}

async fn hand_on(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, bytes: Arc<AtomicU64>) {
    let mut buffer = vec![0; 64 << 10];
    while let Ok(count @ 1..) = from.read(&mut buffer).await {
        bytes.fetch_add(count as u64, Ordering::Relaxed);
        if to.write_all(&buffer[..count]).await.is_err() {
            return;
        }
    }
}
