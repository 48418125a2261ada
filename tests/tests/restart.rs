//! Crashes, restarts, retries: what was acknowledged stays, counts once, and looks the same.

use std::fs;

use echofix_client::upload::PreparedUpload;
use echofix_proto::v1::map_service_client::MapServiceClient;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{GetCoverageRequest, UploadResponse};
use echofix_tests::service::Service;
use echofix_tests::tiles::Tiles;
use echofix_tests::{grpc, http, mapping, tiles, town, until};
use std::time::Duration;

/// A drive through a part of the town, cut into uploads.
fn some_uploads() -> Vec<PreparedUpload> {
    let seed = town::seed();
    let city = town::town(seed);
    let uploads = mapping::uploads(&town::wander(&city, 0, "mapper", seed, 400.0));
    assert!(uploads.len() >= 4, "{} uploads", uploads.len());
    uploads
}

async fn send(service: &Service, upload: &PreparedUpload) -> UploadResponse {
    let mut client = grpc::mapping(service).await;
    mapping::send(&mut client, upload.parts()).await.expect("the upload is acknowledged")
}

/// The map, once it shows all uploads, and its epoch.
async fn map(service: &Service) -> (u64, Tiles) {
    (mapping::folded(service).await, tiles::all(service).await)
}

/// The map of these uploads on a service that never crashes.
async fn undisturbed(uploads: &[PreparedUpload]) -> (u64, Tiles) {
    let service = Service::start();
    for upload in uploads {
        send(&service, upload).await;
    }
    let (epoch, map) = map(&service).await;
    (epoch, tiles::but_lineage(map))
}

/// Catches an acknowledgement that comes before the journal is on disk, a fold that is lost or done
/// twice over a crash, and a dedup index that lives in memory only.
#[tokio::test(flavor = "multi_thread")]
async fn a_crash_after_any_acknowledgement_loses_nothing_and_counts_nothing_twice() {
    let uploads = some_uploads();
    let mut service = Service::start();
    let mut acknowledged = Vec::new();
    for upload in &uploads {
        acknowledged.push(send(&service, upload).await);
        // At once: folding has hardly begun.
        service.kill();
        service.start_again();
    }
    let crashed = map(&service).await;
    for (upload, first) in uploads.iter().zip(&acknowledged) {
        let again = send(&service, upload).await;
        assert_eq!(
            again,
            UploadResponse { duplicate: true, ..first.clone() },
            "a retry repeats the first answer"
        );
    }
    assert_eq!(map(&service).await, crashed, "a retry changes nothing");
    let alike = (crashed.0, tiles::but_lineage(crashed.1));
    assert_eq!(alike, undisturbed(&uploads).await, "a crash leaves no trace in the map");
    assert_eq!(alike.0, uploads.len() as u64);
}

/// Catches a restart that starts from an older map, or folds the journal a second time.
#[tokio::test(flavor = "multi_thread")]
async fn the_same_map_is_served_after_a_crash_and_after_an_orderly_end() {
    let mut service = Service::start();
    for upload in some_uploads() {
        send(&service, &upload).await;
    }
    let before = map(&service).await;
    service.kill();
    service.start_again();
    // Without waiting: ready means that the map shows all it showed before.
    assert_eq!(tiles::all(&service).await, before.1);
    assert_eq!(map(&service).await, before);
    service.ask_to_end();
    assert!(service.ended().success());
    service.start_again();
    assert_eq!(tiles::all(&service).await, before.1);
    assert_eq!(map(&service).await, before);
}

/// Catches a journal that does not hold all that the map is made of.
#[tokio::test(flavor = "multi_thread")]
async fn a_deleted_index_is_rebuilt_from_the_journal_to_the_same_bytes() {
    let mut service = Service::start();
    let uploads = some_uploads();
    for upload in &uploads {
        send(&service, upload).await;
    }
    let before = map(&service).await;
    service.ask_to_end();
    assert!(service.ended().success());
    fs::remove_dir_all(service.data_dir().join("tiles-1")).expect("the map's folder is there");
    service.start_again();
    assert_eq!(map(&service).await, before);
    assert!(send(&service, &uploads[0]).await.duplicate);
}

/// Catches a SIGTERM that cuts off what is under way, hangs, or is not an orderly end; and probes
/// that go on calling a service ready that takes no new requests.
#[tokio::test(flavor = "multi_thread")]
async fn sigterm_drains_and_exits_with_zero() {
    let mut service = Service::start();
    let uploads = some_uploads();
    send(&service, &uploads[0]).await;
    // An upload under way: its header is sent, the rest comes after SIGTERM.
    let channel = grpc::connect(&service).await;
    let (mut client, mut reader) =
        (MappingServiceClient::new(channel.clone()), MapServiceClient::new(channel));
    let (parts, received) = tokio::sync::mpsc::channel(1);
    let mut rest = uploads[1].parts().to_vec().into_iter();
    parts.send(rest.next().unwrap()).await.unwrap();
    let stream = tokio_stream::wrappers::ReceiverStream::new(received);
    let answer = tokio::spawn(async move { client.upload(stream).await });
    // The header is taken once there is room for more; an answer to what came after it on the same
    // connection tells that the service has it.
    drop(parts.reserve().await.expect("the upload is under way"));
    reader.get_coverage(GetCoverageRequest::default()).await.expect("the map can be read");
    service.ask_to_end();
    until("the service takes no new connections", Duration::from_secs(5), async || {
        http::try_get(&format!("{}/readyz", service.http))
            .is_none_or(|answer| answer.status == 503)
            .then_some(())
    })
    .await;
    for part in rest {
        parts.send(part).await.expect("the upload under way goes on");
    }
    drop(parts);
    let answer = answer.await.unwrap().expect("the upload under way is acknowledged").into_inner();
    assert!(!answer.duplicate && answer.detections_counted > 0);
    let status = service.ended();
    assert_eq!(status.code(), Some(0), "{}", service.log());
    service.start_again();
    assert_eq!(map(&service).await.0, 2, "what was acknowledged while draining is there");
}

/// Catches two services that write to the same data.
#[tokio::test(flavor = "multi_thread")]
async fn a_second_service_on_the_same_data_refuses_to_start() {
    let service = Service::start();
    let run = echofix_tests::command::echofix([
        "serve",
        "--set",
        "grpc.listen=127.0.0.1:0",
        "--set",
        "http.listen=127.0.0.1:0",
        "--data-dir",
        service.data_dir().to_str().unwrap(),
    ]);
    assert_eq!(run.code, Some(1), "{run:?}");
    assert!(run.stderr.contains("in use"), "{run:?}");
}

/// Catches an upload whose header alone, repeated under another id, is taken for a copy.
#[tokio::test(flavor = "multi_thread")]
async fn the_same_scans_under_a_new_id_are_a_new_upload() {
    let service = Service::start();
    let upload = some_uploads().remove(0);
    send(&service, &upload).await;
    let mut parts = upload.parts().to_vec();
    if let Some(Part::Header(header)) = &mut parts[0].part {
        header.upload_id = uuid::Uuid::now_v7().to_string();
    }
    let mut client = grpc::mapping(&service).await;
    let answer = mapping::send(&mut client, &parts).await.expect("it is acknowledged");
    assert!(!answer.duplicate && answer.epoch == 2);
    mapping::folded(&service).await;
    // One contributor on one day is one vote, however often it uploads.
    for (_, encoded) in tiles::all(&service).await.values() {
        let tile = echofix_core::tile::decode(encoded).expect("a served tile decodes");
        assert!(tile.cells().iter().all(|(_, cell)| cell.passes == 1 && cell.hits >= 2));
    }
}
