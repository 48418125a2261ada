//! The uploader against services that fail, hang, forget to answer and refuse.

use super::*;
use crate::backoff::BackoffPolicy;
use crate::testing::service::{Behaviour, MockService};
use crate::testing::upload;
use crate::upload::spool::SpoolLimits;
use std::collections::HashSet;
use tempfile::TempDir;
use tonic::transport::Endpoint;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};
use uuid::Uuid;

const SOON: Duration = Duration::from_secs(20);

fn options() -> UploaderOptions {
    let backoff = BackoffPolicy { initial: Duration::from_millis(5), max: Duration::from_millis(40) };
    UploaderOptions { backoff, patience: Duration::from_secs(1), slowest_bytes_per_s: 1_000_000 }
}

fn uploader(endpoint: Endpoint, dir: &TempDir) -> Uploader {
    Uploader::start(endpoint, Spool::open(dir.path(), SpoolLimits::default()).unwrap(), options())
}

async fn submit(uploader: &Uploader, count: usize) -> Vec<Uuid> {
    let mut ids = Vec::new();
    for _ in 0..count {
        let upload = upload(5);
        ids.push(upload.id());
        uploader.submit(upload).await.unwrap();
    }
    ids
}

#[tokio::test]
async fn everything_arrives_in_order_and_leaves_the_disk() {
    let (dir, service) = (tempfile::tempdir().unwrap(), MockService::start(vec![]).await);
    let uploader = uploader(service.endpoint(), &dir);
    let ids = submit(&uploader, 10).await;
    uploader.flush(SOON).await.unwrap();
    assert_eq!(service.counted(), ids);
    assert_eq!(uploader.progress(), UploadProgress { sent: 10, ..UploadProgress::default() });
    let files = std::fs::read_dir(dir.path()).unwrap().filter(|e| e.as_ref().unwrap().path().is_file());
    assert_eq!(files.count(), 1, "only the lock is left");
}

#[tokio::test]
async fn failures_hangs_and_lost_acknowledgements_lose_and_double_nothing() {
    let retry = ErrorDetails::with_retry_info(Some(Duration::from_millis(10)));
    let script = vec![
        Behaviour::Fail(Status::unavailable("restarting")),
        Behaviour::LoseAnswer,
        Behaviour::Hang,
        Behaviour::Fail(Status::with_error_details(Code::ResourceExhausted, "full", retry)),
        Behaviour::Accept,
        Behaviour::Fail(Status::internal("a bug")),
        Behaviour::HangAfterCounting,
        Behaviour::LoseAnswer,
        Behaviour::Fail(Status::unauthenticated("certificate expired")),
    ];
    let (dir, service) = (tempfile::tempdir().unwrap(), MockService::start(script).await);
    let uploader = uploader(service.endpoint(), &dir);
    let ids = submit(&uploader, 6).await;
    uploader.flush(SOON).await.unwrap();
    let counted = service.counted();
    assert_eq!(counted.len(), 6, "no id counts twice");
    assert_eq!(counted.iter().collect::<HashSet<_>>(), ids.iter().collect::<HashSet<_>>());
    let progress = uploader.progress();
    assert_eq!((progress.sent, progress.duplicates, progress.refused), (6, 3, 0));
}

#[tokio::test]
async fn the_service_s_wish_to_wait_is_honoured() {
    let wish = Duration::from_millis(400);
    let details = ErrorDetails::with_retry_info(Some(wish));
    let shed = Status::with_error_details(Code::ResourceExhausted, "full", details);
    let (dir, service) =
        (tempfile::tempdir().unwrap(), MockService::start(vec![Behaviour::Fail(shed)]).await);
    let uploader = uploader(service.endpoint(), &dir);
    submit(&uploader, 1).await;
    uploader.flush(SOON).await.unwrap();
    let calls = service.call_times();
    assert!(calls[1] - calls[0] >= wish, "{:?}", calls[1] - calls[0]);
}

#[tokio::test]
async fn refusals_are_kept_with_their_reason_and_hold_up_nothing() {
    let info = ErrorDetails::with_error_info("TOO_OLD", "echofix", []);
    let script = vec![
        Behaviour::Fail(Status::with_error_details(Code::FailedPrecondition, "from last year", info)),
        Behaviour::Fail(Status::invalid_argument("no chunk")),
    ];
    let (dir, service) = (tempfile::tempdir().unwrap(), MockService::start(script).await);
    let uploader = uploader(service.endpoint(), &dir);
    let ids = submit(&uploader, 3).await;
    uploader.flush(SOON).await.unwrap();
    assert_eq!(service.counted(), [ids[2]]);
    assert_eq!(uploader.progress().refused, 2);
    let text = dir.path().join("refused").join(format!("{}.txt", ids[0]));
    assert!(std::fs::read_to_string(text).unwrap().contains("TOO_OLD"));
    assert!(dir.path().join("refused").join(format!("{}.upload", ids[1])).exists());
}

#[tokio::test]
async fn one_upload_that_the_service_fails_on_does_not_hold_up_the_others() {
    let (dir, service) = (tempfile::tempdir().unwrap(), MockService::start(vec![]).await);
    let uploader = uploader(service.endpoint(), &dir);
    let poison = upload(5);
    service.fail_always(poison.id());
    let poison_id = poison.id();
    uploader.submit(poison).await.unwrap();
    let ids = submit(&uploader, 5).await;
    assert_eq!(uploader.flush(Duration::from_secs(2)).await.unwrap_err().waiting, 1);
    assert_eq!(service.counted(), ids);
    assert_eq!(uploader.spool.oldest(&HashSet::new()), Some(poison_id));
}

#[tokio::test]
async fn an_outage_and_a_restart_of_the_vehicle_lose_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let nobody = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let away = Endpoint::from_shared(format!("http://{nobody}")).unwrap();
    let before = uploader(away, &dir);
    let mut ids = submit(&before, 3).await;
    let error = before.flush(Duration::from_millis(100)).await.unwrap_err();
    assert_eq!(error.waiting, 3);
    before.close().await;

    let mut damaged = std::fs::read(dir.path().join(format!("{}.upload", ids[1]))).unwrap();
    damaged.truncate(40);
    std::fs::write(dir.path().join(format!("{}.upload", ids[1])), damaged).unwrap();
    ids.remove(1);

    let service = MockService::start(vec![Behaviour::LoseAnswer]).await;
    let after = uploader(service.endpoint(), &dir);
    ids.extend(submit(&after, 2).await);
    after.flush(SOON).await.unwrap();
    assert_eq!(service.counted(), ids);
    assert_eq!(after.progress().damaged, 1);
}

#[tokio::test]
async fn dropping_the_uploader_in_the_middle_of_a_call_keeps_the_upload() {
    let dir = tempfile::tempdir().unwrap();
    let service = MockService::start(vec![Behaviour::HangAfterCounting]).await;
    let first = uploader(service.endpoint(), &dir);
    let ids = submit(&first, 1).await;
    service.wait_for_calls(1).await;
    first.close().await;
    let second = uploader(service.endpoint(), &dir);
    second.flush(SOON).await.unwrap();
    assert_eq!(service.counted(), ids);
    assert_eq!(second.progress().duplicates, 1);
}
