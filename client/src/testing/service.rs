//! A service that misbehaves on demand.

use std::collections::{HashSet, VecDeque};
use std::future;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use echofix_proto::v1;
use echofix_proto::v1::localization_service_server::{LocalizationService, LocalizationServiceServer};
use echofix_proto::v1::localize_stream_response::Outcome;
use echofix_proto::v1::mapping_service_server::{MappingService, MappingServiceServer};
use echofix_proto::v1::upload_request::Part;
use prost::Message;
use tokio::net::TcpListener;
use tokio::time::Instant;
use tokio_stream::wrappers::{ReceiverStream, TcpListenerStream};
use tonic::transport::{Endpoint, Server};
use tonic::{Request, Response, Status, Streaming};
use uuid::Uuid;

/// What the service does with one call.
pub(crate) enum Behaviour {
    Accept,
    Fail(Status),
    /// Counts the upload, then breaks.
    LoseAnswer,
    /// Neither counts nor answers.
    Hang,
    /// Counts, but does not answer.
    HangAfterCounting,
}

#[derive(Default)]
struct MockState {
    script: VecDeque<Behaviour>,
    counted: Vec<Uuid>,
    calls: Vec<Instant>,
    failing: HashSet<Uuid>,
    batches: Vec<v1::Batch>,
    forgetful: bool,
    better: Option<String>,
    regions: Vec<Option<String>>,
}

/// Follows its script, one behaviour a call, then accepts.
#[derive(Clone)]
pub(crate) struct MockService {
    state: Arc<Mutex<MockState>>,
    address: SocketAddr,
}

impl MockService {
    pub(crate) async fn start(script: Vec<Behaviour>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let state = Arc::new(Mutex::new(MockState { script: script.into(), ..MockState::default() }));
        let service = Self { state, address };
        let router = Server::builder()
            .add_service(MappingServiceServer::new(service.clone()))
            .add_service(LocalizationServiceServer::new(service.clone()));
        tokio::spawn(router.serve_with_incoming(TcpListenerStream::new(listener)));
        service
    }

    pub(crate) fn endpoint(&self) -> Endpoint {
        Endpoint::from_shared(self.url()).unwrap()
    }

    pub(crate) fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// From now on its answers say that all is better asked elsewhere.
    pub(crate) fn name_better(&self, url: Option<&str>) {
        self.state.lock().unwrap().better = url.map(str::to_owned);
    }

    /// The regions that callers named.
    pub(crate) fn regions(&self) -> Vec<Option<String>> {
        self.state.lock().unwrap().regions.clone()
    }

    fn heard(&self, metadata: &tonic::metadata::MetadataMap) {
        let region = metadata.get("x-echofix-region").map(|region| region.to_str().unwrap().to_owned());
        self.state.lock().unwrap().regions.push(region);
    }

    fn answered<T>(&self, answer: T) -> Response<T> {
        let mut answer = Response::new(answer);
        if let Some(better) = &self.state.lock().unwrap().better {
            answer.metadata_mut().insert("x-echofix-better-asked-at", better.parse().unwrap());
        }
        answer
    }

    /// Ids that count, in the order of their first arrival.
    pub(crate) fn counted(&self) -> Vec<Uuid> {
        self.state.lock().unwrap().counted.clone()
    }

    pub(crate) fn call_times(&self) -> Vec<Instant> {
        self.state.lock().unwrap().calls.clone()
    }

    pub(crate) fn fail_always(&self, id: Uuid) {
        self.state.lock().unwrap().failing.insert(id);
    }

    pub(crate) async fn wait_for_calls(&self, count: usize) {
        while self.call_times().len() < count {
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }

    fn next(&self) -> Behaviour {
        let mut state = self.state.lock().unwrap();
        state.calls.push(Instant::now());
        state.script.pop_front().unwrap_or(Behaviour::Accept)
    }

    /// True when the id had been counted before.
    fn count(&self, id: Uuid) -> bool {
        let counted = &mut self.state.lock().unwrap().counted;
        let duplicate = counted.contains(&id);
        if !duplicate {
            counted.push(id);
        }
        duplicate
    }
}

#[tonic::async_trait]
impl MappingService for MockService {
    async fn upload(
        &self,
        request: Request<Streaming<v1::UploadRequest>>,
    ) -> Result<Response<v1::UploadResponse>, Status> {
        self.heard(request.metadata());
        let mut parts = request.into_inner();
        let Some(v1::UploadRequest { part: Some(Part::Header(header)) }) = parts.message().await? else {
            return Err(Status::invalid_argument("no header"));
        };
        while parts.message().await?.is_some() {}
        let id = Uuid::parse_str(&header.upload_id).unwrap();
        if self.state.lock().unwrap().failing.contains(&id) {
            return Err(Status::internal("always"));
        }
        let duplicate = match self.next() {
            Behaviour::Accept => self.count(id),
            Behaviour::Fail(status) => return Err(status),
            Behaviour::Hang => future::pending().await,
            behaviour => {
                self.count(id);
                match behaviour {
                    Behaviour::LoseAnswer => return Err(Status::unavailable("the connection broke")),
                    _ => future::pending().await,
                }
            }
        };
        Ok(Response::new(v1::UploadResponse { upload_id: header.upload_id, duplicate, ..Default::default() }))
    }
}

#[tonic::async_trait]
impl LocalizationService for MockService {
    async fn localize(
        &self,
        request: Request<v1::LocalizeRequest>,
    ) -> Result<Response<v1::LocalizeResponse>, Status> {
        self.heard(request.metadata());
        let time_us = request.into_inner().batch.unwrap_or_default().reference_time_us;
        match self.next() {
            Behaviour::Accept => Ok(self.answered(super::usable_answer(time_us))),
            Behaviour::Fail(status) => Err(status),
            _ => future::pending().await,
        }
    }

    type LocalizeStreamStream = ReceiverStream<Result<v1::LocalizeStreamResponse, Status>>;

    /// Keeps the last batch, where it keeps any; a scripted failure is an answer, a lost one the end of the stream.
    async fn localize_stream(
        &self,
        request: Request<Streaming<v1::LocalizeStreamRequest>>,
    ) -> Result<Response<Self::LocalizeStreamStream>, Status> {
        self.heard(request.metadata());
        let (this, mut asked) = (self.clone(), request.into_inner());
        let (answers, answered) = tokio::sync::mpsc::channel(1);
        tokio::spawn(async move {
            let mut kept: Option<(u64, v1::Batch)> = None;
            while let Ok(Some(asked)) = asked.message().await {
                let behaviour = this.next();
                let Some(answer) = this.stream_answer(asked, behaviour, &mut kept) else { return };
                if answers.send(Ok(answer)).await.is_err() {
                    return;
                }
            }
        });
        Ok(self.answered(ReceiverStream::new(answered)))
    }
}

impl MockService {
    /// The batches it was asked with by streams, as it made them whole.
    pub(crate) fn batches(&self) -> Vec<v1::Batch> {
        self.state.lock().unwrap().batches.clone()
    }

    pub(crate) fn keep_nothing(&self) {
        self.state.lock().unwrap().forgetful = true;
    }

    fn stream_answer(
        &self,
        asked: v1::LocalizeStreamRequest,
        behaviour: Behaviour,
        kept: &mut Option<(u64, v1::Batch)>,
    ) -> Option<v1::LocalizeStreamResponse> {
        let v1::LocalizeStreamRequest { sequence, request, delta, keep_batch } = asked;
        let refused = |status: &Status, kept: &Option<(u64, v1::Batch)>| {
            let error = tonic_types::pb::Status::decode(status.details()).unwrap_or_default();
            let error = tonic_types::pb::Status { code: status.code().into(), ..error };
            let kept_batch = kept.as_ref().map(|(number, _)| *number);
            Some(v1::LocalizeStreamResponse { sequence, outcome: Some(Outcome::Error(error)), kept_batch })
        };
        match behaviour {
            Behaviour::Accept => {}
            Behaviour::Fail(status) => return refused(&status, kept),
            _ => return None,
        }
        let batch = match delta {
            None => request.unwrap().batch.unwrap(),
            Some(delta) => {
                let (number, base) = kept.as_ref().unwrap();
                assert_eq!(*number, delta.base);
                echofix_proto::delta::applied(base, delta).unwrap()
            }
        };
        let mut state = self.state.lock().unwrap();
        state.batches.push(batch.clone());
        let answer = super::usable_answer(batch.reference_time_us);
        *kept = Some((sequence, batch)).filter(|_| keep_batch && !state.forgetful);
        let kept_batch = kept.as_ref().map(|(number, _)| *number);
        Some(v1::LocalizeStreamResponse { sequence, outcome: Some(Outcome::Response(answer)), kept_batch })
    }
}
