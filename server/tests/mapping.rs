//! Uploads and tiles over a real socket.

#![expect(clippy::unwrap_used, reason = "a test fails by it")]

mod common;

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use common::{NOON_US, TestServer, chunk, chunk_of, drive, header, header_of};
use echofix_core::tile;
use echofix_core::time::{DAY_US, day_of};
use echofix_proto::v1::get_tiles_request::Selection;
use echofix_proto::v1::get_tiles_response::Part;
use echofix_proto::v1::{
    DroppedDetections, GeodeticBox, GetCoverageRequest, GetTilesRequest, TileData, TileId, TileList,
    TileVersion, TilesSummary, UploadChunk, UploadRequest, UploadResponse,
};
use tonic::{Code, Status};
use tonic_types::StatusExt;
use uuid::Uuid;

/// A change that spoils an upload.
type UploadChange = fn(&mut Vec<UploadRequest>);
/// The same with something captured.
type UploadChangeWith<'a> = &'a dyn Fn(&mut Vec<UploadRequest>);

const AUSTIN: (f64, f64) = (30.2672, -97.7431);

fn austin(id: u128) -> Vec<UploadRequest> {
    drive(Uuid::from_u128(id), AUSTIN.0, AUSTIN.1)
}

async fn tiles(
    server: &TestServer,
    request: GetTilesRequest,
) -> Result<(Vec<TileData>, TilesSummary), Status> {
    let mut stream = server.map().await.get_tiles(request).await?.into_inner();
    let mut tiles = Vec::new();
    while let Some(message) = stream.message().await? {
        match message.part.unwrap() {
            Part::Tile(tile) => {
                assert_eq!(tile.encoded_bytes, tile.encoded.len() as u64, "a small tile comes in one piece");
                tiles.push(tile);
            }
            Part::Piece(_) => panic!("a small tile comes in one piece"),
            Part::Summary(summary) => {
                assert!(stream.message().await?.is_none(), "the summary is the last message");
                return Ok((tiles, summary));
            }
        }
    }
    panic!("the answer ends without a summary");
}

fn by_id(ids: Vec<TileId>, have: Vec<TileVersion>) -> GetTilesRequest {
    GetTilesRequest { selection: Some(Selection::Tiles(TileList { ids })), have, ..Default::default() }
}

fn by_area(west_deg: f64, east_deg: f64) -> GetTilesRequest {
    let area = GeodeticBox { south_deg: AUSTIN.0 - 0.01, north_deg: AUSTIN.0 + 0.01, west_deg, east_deg };
    GetTilesRequest { selection: Some(Selection::Area(area)), ..Default::default() }
}

/// The tiles of an upload once the map shows it.
async fn shown(server: &TestServer, upload: &UploadResponse) -> Vec<TileData> {
    let ids: Vec<_> = upload.tiles.iter().map(|tile| tile.tile.unwrap()).collect();
    let deadline = Instant::now() + Duration::from_secs(10);
    loop {
        let (tiles, summary) = tiles(server, by_id(ids.clone(), vec![])).await.unwrap();
        if summary.epoch >= upload.epoch {
            return tiles;
        }
        assert!(Instant::now() < deadline, "the upload is never shown");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn an_upload_comes_back_as_tiles() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let answer = server.upload(austin(1)).await.unwrap();
    assert_eq!((answer.detections_counted, answer.epoch, answer.duplicate), (63, 1, false));
    assert_eq!(answer.dropped.unwrap(), DroppedDetections::default());
    let detections: u32 = answer.tiles.iter().map(|tile| tile.detections).sum();
    assert_eq!(detections, 63);

    let tiles_shown = shown(&server, &answer).await;
    let hits: u32 = tiles_shown
        .iter()
        .flat_map(|t| tile::decode(&t.encoded).unwrap().cells().to_vec())
        .map(|c| c.1.hits)
        .sum();
    assert_eq!((tiles_shown.len(), hits), (answer.tiles.len(), 63));

    // Differential: what the caller has is not sent again, what is not there is named.
    let mut have: Vec<_> = tiles_shown.iter().map(|tile| tile.version.unwrap()).collect();
    let nowhere = TileId { epsg: 32614, x: 5, y: 5 };
    have.push(TileVersion { tile: Some(nowhere), version: 3 });
    let (sent, summary) = tiles(&server, by_area(AUSTIN.1 - 0.01, AUSTIN.1 + 0.01)).await.unwrap();
    assert_eq!((sent.len(), summary.sent as usize), (tiles_shown.len(), tiles_shown.len()));
    let request = GetTilesRequest { have, ..by_area(AUSTIN.1 - 0.01, AUSTIN.1 + 0.01) };
    let (sent, summary) = tiles(&server, request).await.unwrap();
    assert_eq!((sent.len(), summary.unchanged as usize), (0, tiles_shown.len()));
    assert_eq!(summary.absent, [nowhere]);
    let (sent, _) = tiles(&server, by_area(AUSTIN.1 + 0.01, AUSTIN.1 + 0.02)).await.unwrap();
    assert!(sent.is_empty());

    let route = GetCoverageRequest {
        latitude_deg: vec![AUSTIN.0, AUSTIN.0 + 0.1, 89.0],
        longitude_deg: vec![AUSTIN.1, AUSTIN.1, 0.0],
        expectations: false,
    };
    let coverage = server.map().await.get_coverage(route).await.unwrap().into_inner();
    let day = u32::from(day_of(NOON_US));
    assert!(coverage.cells[0] > 20 && coverage.cells[1..] == [0, 0], "{coverage:?}");
    assert_eq!(coverage.newest_day, [day, 0, 0]);
    assert_eq!(coverage.contributors, [0; 3], "nothing waits where one contributor is enough");
    server.stop().await;
}

#[tokio::test]
async fn a_retry_counts_once_also_across_a_restart() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let first = server.upload(austin(1)).await.unwrap();
    let expected = UploadResponse { duplicate: true, ..first.clone() };
    let retries = (0..6).map(|_| server.upload(austin(1)));
    let mut answers = Vec::new();
    for retry in retries {
        answers.push(retry.await.unwrap());
    }
    assert!(answers.iter().all(|answer| *answer == expected), "{answers:?}");
    let before = shown(&server, &first).await;
    server.stop().await;

    let server = TestServer::start(dir.path()).await;
    assert_eq!(server.upload(austin(1)).await.unwrap(), expected);
    assert_eq!(shown(&server, &first).await, before);
    server.stop().await;
}

#[tokio::test]
async fn one_id_sent_at_once_by_many_counts_once() {
    let dir = tempfile::tempdir().unwrap();
    let server = std::sync::Arc::new(TestServer::start(dir.path()).await);
    let tasks: Vec<_> = (0..8)
        .map(|_| {
            let server = server.clone();
            tokio::spawn(async move { server.upload(austin(1)).await.unwrap() })
        })
        .collect();
    let mut duplicates = 0;
    for task in tasks {
        let answer = task.await.unwrap();
        assert_eq!(answer.epoch, 1);
        duplicates += u32::from(answer.duplicate);
    }
    assert_eq!(duplicates, 7);
}

#[tokio::test]
async fn near_a_zone_border_both_zones_learn_and_detections_count_once() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let answer = server.upload(drive(Uuid::from_u128(1), 51.0, 5.999)).await.unwrap();
    assert_eq!(answer.detections_counted, 63);
    let zones: BTreeSet<u32> = answer.tiles.iter().map(|tile| tile.tile.unwrap().epsg).collect();
    assert_eq!(zones, BTreeSet::from([32631, 32632]));
    server.stop().await;
}

#[tokio::test]
async fn malformed_uploads_name_the_field() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::start(dir.path()).await;
    let cases: [(&str, UploadChange); 12] = [
        ("header", |m| drop(m.remove(0))),
        ("header", |m| m.push(header(Uuid::nil()))),
        ("chunk", |m| m.truncate(1)),
        ("part", |m| m.push(UploadRequest::default())),
        ("header.upload_id", |m| header_of(m).upload_id = "seven".to_owned()),
        ("header.contributor", |m| header_of(m).contributor.clear()),
        ("header.contributor", |m| header_of(m).contributor = "x".repeat(65)),
        ("header.mounts", |m| header_of(m).mounts.clear()),
        ("header.reference_time_us", |m| header_of(m).reference_time_us = -1),
        ("chunk.scans", |m| m.push(chunk(UploadChunk::default()))),
        ("chunk.scans.range_m", |m| chunk_of(m).1.range_m[3] = f32::NAN),
        ("chunk.poses.yaw_rad", |m| chunk_of(m).0.yaw_rad.clear()),
    ];
    for (field, change) in cases {
        let mut messages = austin(1);
        change(&mut messages);
        let status = server.upload(messages).await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument, "{status}");
        assert_eq!(status.get_details_bad_request().unwrap().field_violations[0].field, field);
    }
    server.stop().await;
}

#[tokio::test]
async fn unusable_uploads_are_refused_with_their_reason() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("mapping.max_age_days", "3")]).await;
    let days = |days: i64| {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
        now.as_micros() as i64 - days * DAY_US
    };
    let cases: [(&str, UploadChangeWith); 6] = [
        ("POSE_TOO_UNCERTAIN", &|m| chunk_of(m).0.sigma_position_m.fill(0.5)),
        ("TOO_SLOW", &|m| chunk_of(m).0.latitude_deg.fill(AUSTIN.0)),
        ("NO_DETECTIONS", &|m| {
            let scans = chunk_of(m).1;
            scans.detection_count.fill(0);
            scans.range_m.clear();
            scans.azimuth_rad.clear();
            scans.radial_speed_mps.clear();
        }),
        ("NO_DETECTIONS", &|m| chunk_of(m).1.range_m.fill(80.0)),
        ("OUTSIDE_UTM", &|m| chunk_of(m).0.latitude_deg.fill(89.0)),
        ("TOO_OLD", &|m| header_of(m).reference_time_us = days(5)),
    ];
    for (reason, change) in cases {
        let mut messages = austin(1);
        header_of(&mut messages).reference_time_us = days(1);
        change(&mut messages);
        let status = server.upload(messages).await.unwrap_err();
        assert_eq!(status.code(), Code::FailedPrecondition, "{status}");
        let info = status.get_details_error_info().unwrap();
        assert_eq!((&*info.reason, &*info.domain), (reason, "echofix"));
    }
    let mut messages = austin(1);
    header_of(&mut messages).reference_time_us = days(1);
    assert!(!server.upload(messages).await.unwrap().duplicate, "a refusal does not use the id up");
    server.stop().await;
}

#[tokio::test]
async fn uploads_and_questions_are_bounded() {
    let dir = tempfile::tempdir().unwrap();
    let server = TestServer::with(dir.path(), &[("mapping.max_upload_detections", "100")]).await;
    let mut messages = austin(1);
    messages.push(messages[1].clone());
    let status = server.upload(messages).await.unwrap_err();
    assert_eq!(status.get_details_bad_request().unwrap().field_violations[0].field, "chunk.scans");

    let mut messages = austin(1);
    chunk_of(&mut messages).1.range_m = vec![1.0; 1 << 20];
    assert_eq!(server.upload(messages).await.unwrap_err().code(), Code::OutOfRange);

    let ids = (0..1_025).map(|x| TileId { epsg: 32614, x, y: 0 }).collect();
    let status = tiles(&server, by_id(ids, vec![])).await.unwrap_err();
    assert_eq!(status.get_details_bad_request().unwrap().field_violations[0].field, "tiles.ids");
    let status = tiles(&server, by_id(vec![TileId { epsg: 4326, x: 0, y: 0 }], vec![])).await.unwrap_err();
    assert_eq!(status.get_details_bad_request().unwrap().field_violations[0].field, "tiles.ids[0].epsg");
    assert_eq!(tiles(&server, GetTilesRequest::default()).await.unwrap_err().code(), Code::InvalidArgument);
    let status = tiles(&server, by_area(f64::NAN, 3.0)).await.unwrap_err();
    assert_eq!(status.get_details_bad_request().unwrap().field_violations[0].field, "area.west_deg");
    server.stop().await;
}
