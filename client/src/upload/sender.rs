//! The background task that empties the spool.

use std::collections::HashSet;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use echofix_proto::v1;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use prost::Message;
use tokio::sync::watch;
use tonic::Request;
use uuid::Uuid;

use super::PreparedUpload;
use super::progress::{Observer, UploadEvent, UploadProgress, UploaderOptions};
use super::spool::{self, Spool};
use crate::backoff::Backoff;
use crate::refusal::CallError;
use crate::routing;
use crate::service::{CallerChannel, ServiceEndpoint};

/// What goes wrong with one upload.
enum Trouble {
    Call(CallError),
    Spool(spool::Error),
}

pub(super) struct Sender {
    pub spool: Arc<Spool>,
    pub endpoint: ServiceEndpoint,
    pub options: UploaderOptions,
    pub progress: watch::Sender<UploadProgress>,
    pub observer: Observer,
    /// Turns true when the uploader closes.
    pub stop: watch::Receiver<bool>,
}

impl Sender {
    /// Sends until it has to stop, oldest first.
    pub(super) async fn run(mut self) {
        let mut client = self.connect();
        let mut backoff = Backoff::new(self.options.backoff);
        // Uploads that the service fails on, or that do not get through in time, are passed over for a
        // round: one must not hold up all.
        let mut passed_over = HashSet::new();
        while !*self.stop.borrow() {
            let Some(id) = self.next(&mut passed_over).await else { return };
            let Err(trouble) = self.handle(id, &mut client).await else {
                backoff.reset();
                continue;
            };
            let (error, retry_after) = match trouble {
                Trouble::Call(error) => {
                    if matches!(error, CallError::Failed { .. } | CallError::Deadline) {
                        passed_over.insert(id);
                    }
                    // A connection that went silent is not used again.
                    client = self.connect();
                    (error.to_string(), error.retry_after())
                }
                Trouble::Spool(error) => (error.to_string(), None),
            };
            let wait = backoff.next(retry_after);
            tracing::info!(%id, error, ?wait, "an upload waits to be sent again");
            self.progress.send_modify(|p| p.last_error = Some(error.clone()));
            (self.observer)(UploadEvent::Delayed { id, error });
            if self.unless_stopped(tokio::time::sleep(wait)).await.is_none() {
                return;
            }
        }
    }

    /// The next upload to send, once there is one; `None` when it has to stop.
    async fn next(&mut self, passed_over: &mut HashSet<Uuid>) -> Option<Uuid> {
        let mut changes = self.progress.subscribe();
        loop {
            changes.mark_unchanged();
            if let Some(id) = self.spool.oldest(passed_over) {
                return Some(id);
            }
            if passed_over.is_empty() {
                self.unless_stopped(changes.changed()).await?.ok()?;
            } else {
                passed_over.clear();
            }
        }
    }

    /// Sends one upload and does with its file what the answer asks for.
    async fn handle(
        &mut self,
        id: Uuid,
        client: &mut MappingServiceClient<CallerChannel>,
    ) -> Result<(), Trouble> {
        let Some(upload) = self.on_disk(move |spool| spool.read(id)).await.map_err(Trouble::Spool)? else {
            self.advance(|p| p.damaged += 1);
            (self.observer)(UploadEvent::Damaged { id });
            return Ok(());
        };
        let patience = self.options.patience(upload.parts().iter().map(Message::encoded_len).sum());
        let Some(answer) = self.unless_stopped(send(client, upload, patience)).await else { return Ok(()) };
        match answer {
            Ok(answer) => {
                self.on_disk(move |spool| spool.remove(id)).await.map_err(Trouble::Spool)?;
                self.advance(|p| {
                    p.sent += 1;
                    p.duplicates += u64::from(answer.duplicate);
                    p.last_error = None;
                });
                (self.observer)(UploadEvent::Acknowledged(answer));
                Ok(())
            }
            Err(error) if error.is_transient() => Err(Trouble::Call(error)),
            Err(error) => {
                let reason = error.to_string();
                let told = reason.clone();
                self.on_disk(move |spool| spool.refuse(id, &told)).await.map_err(Trouble::Spool)?;
                self.advance(|p| {
                    p.refused += 1;
                    p.last_error = Some(reason.clone());
                });
                (self.observer)(UploadEvent::Refused { id, reason });
                Ok(())
            }
        }
    }

    fn connect(&self) -> MappingServiceClient<CallerChannel> {
        MappingServiceClient::new(self.endpoint.connect_lazy())
    }

    fn advance(&self, change: impl FnOnce(&mut UploadProgress)) {
        self.progress.send_modify(|progress| {
            change(progress);
            progress.observe(&self.spool);
        });
    }

    async fn on_disk<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Spool) -> Result<T, spool::Error> + Send + 'static,
    ) -> Result<T, spool::Error> {
        on_disk(&self.spool, work).await
    }

    /// What the future gives, or `None` once it has to stop.
    async fn unless_stopped<T>(&mut self, future: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            biased;
            _ = self.stop.wait_for(|stop| *stop) => None,
            value = future => Some(value),
        }
    }
}

/// Disk work off the async threads; it is finished even when the caller goes away.
pub(super) async fn on_disk<T: Send + 'static>(
    spool: &Arc<Spool>,
    work: impl FnOnce(&Spool) -> Result<T, spool::Error> + Send + 'static,
) -> Result<T, spool::Error> {
    let spool = Arc::clone(spool);
    let done = tokio::task::spawn_blocking(move || work(&spool)).await;
    done.unwrap_or_else(|e| Err(spool::Error::Io { path: "spool".into(), source: std::io::Error::other(e) }))
}

async fn send(
    client: &mut MappingServiceClient<CallerChannel>,
    upload: PreparedUpload,
    patience: Duration,
) -> Result<v1::UploadResponse, CallError> {
    let (id, region) = (upload.id().to_string(), upload.region());
    let mut request = Request::new(tokio_stream::iter(upload.into_parts()));
    routing::mark(&mut request, region);
    request.set_timeout(patience);
    let answer = match tokio::time::timeout(patience, client.upload(request)).await {
        Err(_) => return Err(CallError::Deadline),
        Ok(Err(status)) => return Err(CallError::from(&status)),
        Ok(Ok(answer)) => answer.into_inner(),
    };
    if answer.upload_id == id {
        Ok(answer)
    } else {
        let message = format!("the acknowledgement is for upload `{}`", answer.upload_id);
        Err(CallError::Failed { code: tonic::Code::Internal, message })
    }
}
