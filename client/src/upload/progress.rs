//! How uploads are sent, how far they are, and what becomes of each.

use std::sync::Arc;
use std::time::Duration;

use echofix_proto::v1;
use uuid::Uuid;

use super::spool::Spool;
use crate::backoff::BackoffPolicy;

/// How patiently uploads are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UploaderOptions {
    /// Waits between attempts.
    pub backoff: BackoffPolicy,
    /// An acknowledgement is waited for at least this long.
    pub patience: Duration,
    /// The slowest connection that is still of use, bytes per second: a large upload is waited for
    /// as much longer as it takes at this rate.
    pub slowest_bytes_per_s: u32,
}

impl Default for UploaderOptions {
    /// Half a minute, and longer where the network gives less than 500 bytes a second.
    fn default() -> Self {
        Self {
            backoff: BackoffPolicy::default(),
            patience: Duration::from_secs(30),
            slowest_bytes_per_s: 500,
        }
    }
}

impl UploaderOptions {
    pub(super) fn patience(&self, bytes: usize) -> Duration {
        self.patience + Duration::from_secs(bytes as u64 / u64::from(self.slowest_bytes_per_s.max(1)))
    }
}

/// How far the uploads are.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct UploadProgress {
    /// Uploads in the spool.
    pub waiting: usize,
    /// Bytes of them.
    pub waiting_bytes: u64,
    /// Uploads acknowledged since the start.
    pub sent: u64,
    /// Of those, uploads the service already had: an earlier acknowledgement was lost.
    pub duplicates: u64,
    /// Uploads moved to `refused/` since the start.
    pub refused: u64,
    /// Files moved to `damaged/` since the start.
    pub damaged: u64,
    /// What last went wrong; cleared by the next success.
    pub last_error: Option<String>,
}

impl UploadProgress {
    pub(super) fn observe(&mut self, spool: &Spool) {
        (self.waiting, self.waiting_bytes) = (spool.len(), spool.bytes());
    }
}

/// What has become of one upload.
#[derive(Debug, Clone, PartialEq)]
pub enum UploadEvent {
    /// The service has it.
    Acknowledged(v1::UploadResponse),
    /// The service will never take it; it lies in `refused/`.
    Refused {
        /// Its id.
        id: Uuid,
        /// Why not.
        reason: String,
    },
    /// Its file was damaged; it lies in `damaged/`.
    Damaged {
        /// Its id.
        id: Uuid,
    },
    /// It could not be sent, and is tried again.
    Delayed {
        /// Its id.
        id: Uuid,
        /// Why.
        error: String,
    },
}

/// Is told what becomes of uploads.
pub(super) type Observer = Arc<dyn Fn(UploadEvent) + Send + Sync>;
