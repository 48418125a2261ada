//! Log lines carry the id of the request they belong to, and the answer names it.

#![expect(clippy::unwrap_used, reason = "a test fails by it")]

mod common;

use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use common::{TestServer, chunk_of, drive};
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_proto::v1::{LocalizeRequest, LocalizeStreamRequest, UploadRequest};
use serde_json::Value;
use tonic::{Request, Status};
use uuid::Uuid;

/// What was logged.
#[derive(Clone, Default)]
struct CapturedLog(Arc<Mutex<Vec<u8>>>);

impl Write for CapturedLog {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl CapturedLog {
    fn lines(&self) -> Vec<Value> {
        let bytes = self.0.lock().unwrap().clone();
        String::from_utf8(bytes).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// The ids in the spans of the lines that `is_meant` means.
    fn ids(&self, is_meant: impl Fn(&Value) -> bool) -> Vec<String> {
        let id = |line: &Value| {
            let spans = line["spans"].as_array().cloned().unwrap_or_default();
            spans.iter().find_map(|span| Some(span["request_id"].as_str()?.to_owned())).unwrap_or_default()
        };
        self.lines().iter().filter(|line| is_meant(line)).map(id).collect()
    }
}

fn with_id<T>(message: T, id: &str) -> Request<T> {
    let mut request = Request::new(message);
    request.metadata_mut().insert("x-request-id", id.parse().unwrap());
    request
}

/// Sends an upload under a request id; gives back the id that the answer names, and the upload's fate.
async fn sent(server: &TestServer, messages: Vec<UploadRequest>, id: &str) -> (String, Result<u64, Status>) {
    let mut client = MappingServiceClient::new(server.channel().await);
    let answer = client.upload(with_id(tokio_stream::iter(messages), id)).await;
    let metadata = match &answer {
        Ok(response) => response.metadata().clone(),
        Err(status) => status.metadata().clone(),
    };
    let named = metadata.get("x-request-id").unwrap().to_str().unwrap().to_owned();
    (named, answer.map(|response| response.into_inner().epoch))
}

#[tokio::test]
async fn log_lines_carry_the_id_of_their_request_and_answers_name_it() {
    let log = CapturedLog::default();
    let writer = log.clone();
    let filter = tracing_subscriber::EnvFilter::new("info,echofix_server=debug");
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(move || writer.clone());
    lines.json().flatten_event(true).init();
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;

    let counted = drive(Uuid::from_u128(1), 30.0, -97.0);
    let mut refused = drive(Uuid::from_u128(2), 30.0, -97.0);
    chunk_of(&mut refused).1.range_m.fill(80.0);
    let (first, second) = tokio::join!(sent(&server, counted, "first-1"), sent(&server, refused, "second-2"));
    assert_eq!((&*first.0, first.1.unwrap()), ("first-1", 1));
    assert!(second.0 == "second-2" && second.1.is_err());
    assert_eq!(log.ids(|line| line["message"] == "upload counted" && line["epoch"] == 1), ["first-1"]);
    assert_eq!(log.ids(|line| line["reason"] == "NO_DETECTIONS"), ["second-2"]);

    // Another id than a sane one is replaced, and never logged.
    let again = drive(Uuid::from_u128(3), 30.0, -97.0);
    let (named, epoch) = sent(&server, again, "two words").await;
    assert!(Uuid::try_parse(&named).is_ok(), "{named}");
    assert_eq!(
        log.ids(|line| line["message"] == "upload counted" && line["epoch"] == epoch.clone().unwrap()),
        [named]
    );
    assert!(!log.lines().iter().any(|line| line.to_string().contains("two words")));

    let mut client = LocalizationServiceClient::new(server.channel().await);
    let status = client.localize(with_id(LocalizeRequest::default(), "third-3")).await.unwrap_err();
    assert_eq!(status.metadata().get("x-request-id").unwrap(), "third-3");
    let messages = [4, 5].map(|sequence| LocalizeStreamRequest { sequence, ..Default::default() });
    let response = client.localize_stream(with_id(tokio_stream::iter(messages), "fourth-4")).await.unwrap();
    assert_eq!(response.metadata().get("x-request-id").unwrap(), "fourth-4");
    let mut answers = response.into_inner();
    while answers.message().await.unwrap().is_some() {}
    assert_eq!(log.ids(|line| line["message"] == "request not valid"), ["third-3", "fourth-4", "fourth-4"]);
    let of_message = |line: &Value| line["span"]["sequence"].as_u64();
    let sequences: Vec<_> = log.lines().iter().filter_map(of_message).collect();
    assert!(sequences.contains(&4) && sequences.contains(&5), "{sequences:?}");

    // Who sent it and where from is in no line.
    let text = log.lines().iter().map(Value::to_string).collect::<String>();
    assert!(!text.contains("car-7") && !text.contains("-97."), "{text}");
    server.stop().await;
}
