//! What the vehicle holds of the background task.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::PreparedUpload;
use super::progress::{UploadEvent, UploadProgress, UploaderOptions};
use super::sender::{Sender, on_disk};
use super::spool::{self, Spool};
use crate::service::ServiceEndpoint;

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
        Self::start_observed(endpoint, spool, options, |_| ())
    }

    /// [`Uploader::start`], which tells `observer` what becomes of each upload. It is called from the background task, and must
    /// not block.
    #[must_use]
    pub fn start_observed(
        endpoint: impl Into<ServiceEndpoint>,
        spool: Spool,
        options: UploaderOptions,
        observer: impl Fn(UploadEvent) + Send + Sync + 'static,
    ) -> Self {
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
            observer: Arc::new(observer),
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
