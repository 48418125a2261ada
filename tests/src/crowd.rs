//! A crowd in one street: honest vehicles, some that err, and evidence that no vehicle saw.

use std::collections::BTreeMap;

use echofix_core::drive::Drive;
use echofix_core::evidence::{CellHits, EvidenceDelta, TileEvidence, codec};
use echofix_core::geo::{CellIndex, Grid, TileId, Zone};
use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;
use echofix_core::tile;
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{EvidenceChunk, UploadHeader, UploadRequest};
use echofix_sim::{City, Route};
use serde_json::Value;
use uuid::Uuid;

use crate::http;
use crate::service::Service;
use crate::tiles::Tiles;
use crate::town;

/// Way along the street, metres: some uploads.
const STREET_M: f64 = 250.0;

/// A drive along the street: the same way for everybody, each with errors of its own.
pub fn street(city: &City, day: u32, vehicle: &str) -> Drive {
    let own = vehicle.bytes().fold(u64::from(day), |seed, byte| 31 * seed + u64::from(byte));
    town::drive(city, day, vehicle, own, &Route::wander(city, 1, STREET_M))
}

/// The drive of a vehicle whose positioning errs by this much.
pub fn shifted(mut drive: Drive, east_m: f64, north_m: f64) -> Drive {
    move_all(&mut drive, |pose, _| Pose2::new(pose.x_m + east_m, pose.y_m + north_m, pose.yaw_rad));
    drive
}

/// The drive of a vehicle that believes the street to be turned about its middle.
pub fn turned(mut drive: Drive, yaw_rad: f64) -> Drive {
    move_all(&mut drive, |pose, middle| {
        let (s, c) = yaw_rad.sin_cos();
        let (x, y) = (pose.x_m - middle.x_m, pose.y_m - middle.y_m);
        Pose2::new(middle.x_m + c * x - s * y, middle.y_m + s * x + c * y, pose.yaw_rad + yaw_rad)
    });
    drive
}

fn move_all(drive: &mut Drive, to: impl Fn(&Pose2, MapPoint) -> Pose2) {
    let grid = Grid::of(drive.reference[0].at).expect("the town is on the map");
    let on_grid = |pose: &echofix_core::drive::GeoPose| {
        grid.pose_from_geodetic(pose.at, pose.yaw_rad).expect("the town is on the map")
    };
    let poses: Vec<Pose2> = drive.reference.iter().map(on_grid).collect();
    let count = poses.len() as f64;
    let mean = |along: fn(&Pose2) -> f64| poses.iter().map(along).sum::<f64>() / count;
    let middle = MapPoint::new(mean(|p| p.x_m), mean(|p| p.y_m));
    for (pose, before) in drive.reference.iter_mut().zip(&poses) {
        (pose.at, pose.yaw_rad) = grid.pose_to_geodetic(&to(before, middle)).expect("still on the map");
    }
}

/// Evidence that hits the cells at these points.
pub fn hits(zone: Zone, points: impl IntoIterator<Item = MapPoint>, each: u32) -> EvidenceDelta {
    let mut tiles: BTreeMap<TileId, BTreeMap<u32, CellHits>> = BTreeMap::new();
    for point in points {
        let (id, index) = TileId::locate(zone, CellIndex::of(point));
        let hit = CellHits { index, hits: each, offset_sum: [each * 128; 2] };
        tiles.entry(id).or_default().insert(index, hit);
    }
    let tiles: BTreeMap<_, _> = tiles
        .into_iter()
        .map(|(id, cells)| (id, TileEvidence::of_hits(cells.into_values().collect())))
        .collect();
    let detections = tiles.values().map(TileEvidence::detections).sum();
    EvidenceDelta { tiles, detections }
}

/// Evidence as an upload, whoever made it.
pub fn upload(id: Uuid, contributor: &str, time_us: i64, contribution: &EvidenceDelta) -> Vec<UploadRequest> {
    let header = UploadHeader {
        upload_id: id.to_string(),
        contributor: contributor.to_owned(),
        reference_time_us: time_us,
        ..UploadHeader::default()
    };
    let chunk = |piece: &[u8]| EvidenceChunk {
        contribution: piece.to_vec(),
        sigma_position_m: 0.1,
        sigma_yaw_rad: 0.002,
    };
    let bytes = codec::encode(contribution);
    let chunks = bytes.chunks(16 << 10).map(|piece| Part::Evidence(chunk(piece)));
    std::iter::once(Part::Header(header))
        .chain(chunks)
        .map(|part| UploadRequest { part: Some(part) })
        .collect()
}

/// The quarantine: uploads that vetting kept out of the map, and alarms.
pub fn quarantine(service: &Service) -> Value {
    http::get(&format!("{}/api/v1/map/quarantine", service.http)).json()
}

/// Cells that are served, by tile and index, with their hits.
pub fn cells(tiles: &Tiles) -> BTreeMap<(TileId, u32), u32> {
    let decoded =
        tiles.iter().map(|(id, (_, encoded))| (*id, tile::decode(encoded).expect("a tile decodes")));
    let cells = decoded.flat_map(|(id, tile)| {
        tile.cells().iter().map(|(index, cell)| ((id, *index), cell.hits)).collect::<Vec<_>>()
    });
    cells.collect()
}

/// What is served, without the versions, which depend on the past.
pub fn bytes(tiles: &Tiles) -> BTreeMap<TileId, &[u8]> {
    tiles.iter().map(|(id, (_, encoded))| (*id, &encoded[..])).collect()
}
