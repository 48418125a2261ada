//! The two ports.

/// Which of the two ports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Port {
    /// For vehicles: gRPC, so HTTP/2 only.
    Grpc,
    /// For operators: HTTP/2 and HTTP/1.1.
    Http,
}

impl Port {
    /// Its word in logs and metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Grpc => "grpc",
            Self::Http => "http",
        }
    }
}
