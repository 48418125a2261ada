//! What the vehicle holds of the background task.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::PreparedUpload;
use super::sender::{Sender, on_disk};
use super::spool::{self, Spool};
use crate::backoff::BackoffPolicy;
use crate::service::ServiceEndpoint;

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

/// The deadline passed with uploads left.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{waiting} uploads are still waiting ({}); they stay in the spool and are sent later",
    .last_error.as_deref().unwrap_or("they take longer than the deadline")
)]
pub struct FlushError {
    /// Uploads left.
    pub waiting: usize,
    /// What last went wrong.
    pub last_error: Option<String>,
}

/// Spools uploads and sends them in the background until dropped.
///
/// Dropping it ends the background task at once; what was not acknowledged stays in the spool.
#[derive(Debug)]
pub struct Uploader {
    spool: Arc<Spool>,
    progress: watch::Sender<UploadProgress>,
    stop: watch::Sender<bool>,
    task: Option<JoinHandle<()>>,
}

impl Uploader {
    /// Starts sending what the spool holds and will hold.
    ///
    /// Must be called within a tokio runtime.
    #[must_use]
    pub fn start(endpoint: impl Into<ServiceEndpoint>, spool: Spool, options: UploaderOptions) -> Self {
        let spool = Arc::new(spool);
        let (stop, stopped) = watch::channel(false);
        let mut seen = UploadProgress::default();
        seen.observe(&spool);
        let progress = watch::Sender::new(seen);
        let sender = Sender {
            spool: Arc::clone(&spool),
            endpoint: endpoint.into(),
            options,
            progress: progress.clone(),
            stop: stopped,
        };
        let task = Some(tokio::spawn(sender.run()));
        Self { spool, progress, stop, task }
    }

    /// Puts an upload on disk; once this returns, the upload survives a power cut and will be sent.
    ///
    /// When the future is dropped before, the upload may or may not have been taken; submitting
    /// the same upload again is safe.
    ///
    /// # Errors
    /// When the spool is full or the file system refuses; the upload is not taken then.
    pub async fn submit(&self, upload: PreparedUpload) -> Result<(), spool::Error> {
        let progress = self.progress.clone();
        on_disk(&self.spool, move |spool| {
            spool.push(&upload)?;
            progress.send_modify(|p| p.observe(spool));
            Ok(())
        })
        .await
    }

    /// Waits until everything is acknowledged, or set aside.
    ///
    /// # Errors
    /// When the deadline passes first; sending goes on.
    pub async fn flush(&self, deadline: Duration) -> Result<(), FlushError> {
        let mut progress = self.progress.subscribe();
        let empty = tokio::time::timeout(deadline, progress.wait_for(|p| p.waiting == 0)).await;
        if matches!(empty, Ok(Ok(_))) {
            return Ok(());
        }
        let UploadProgress { waiting, last_error, .. } = self.progress();
        Err(FlushError { waiting, last_error })
    }

    /// How far the uploads are.
    #[must_use]
    pub fn progress(&self) -> UploadProgress {
        self.progress.borrow().clone()
    }

    /// Ends the background task and releases the spool; what was not acknowledged stays in it.
    pub async fn close(mut self) {
        self.stop.send_replace(true);
        if let Some(task) = self.task.take() {
            // It ends by itself; a panic in it has been reported already.
            let _ = task.await;
        }
    }
}

impl Drop for Uploader {
    fn drop(&mut self) {
        if let Some(task) = &self.task {
            task.abort();
        }
    }
}

#[cfg(test)]
mod tests;
