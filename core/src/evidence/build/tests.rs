use crate::evidence::CellHits;
use crate::geo::{CELL_M, LatLon, TileId};
use crate::point::MapPoint;
use proptest::prelude::*;

use super::*;

const AUSTIN: LatLon = LatLon { lat_deg: 30.2672, lon_deg: -97.7431 };

/// North at 10 m/s from `at`, a pose and a scan every 100 ms; each scan sees one point 20 m east.
fn drive(at: LatLon, rows: i64) -> RawUpload {
    let time_us = |i: i64| i * 100_000;
    let pose = |i: i64| GeoPose {
        time_us: time_us(i),
        at: LatLon { lat_deg: at.lat_deg + i as f64 / 111_132.0, ..at },
        yaw_rad: std::f64::consts::FRAC_PI_2,
        sigma_position_m: 0.1,
        sigma_yaw_rad: 0.001,
    };
    let scan = |i: i64| Scan {
        time_us: time_us(i),
        range_m: vec![20.0],
        azimuth_rad: vec![-std::f32::consts::FRAC_PI_2],
        ..Scan::default()
    };
    let chunk = Chunk { poses: (0..rows).map(pose).collect(), scans: (0..rows).map(scan).collect() };
    RawUpload { mounts: vec![Mount::IDENTITY], chunks: vec![chunk] }
}

fn built(upload: RawUpload) -> Result<BuiltEvidence, BuildError> {
    build_evidence(upload, &EvidenceLimits::default())
}

fn hit_positions(built: &BuiltEvidence) -> Vec<MapPoint> {
    let position = |id: &TileId, hit: &CellHits| {
        let [fx, fy] = hit.centroid();
        let (column, row) = (f64::from(hit.index % 512), f64::from(hit.index / 512));
        id.origin().moved((column + fx) * CELL_M, (row + fy) * CELL_M)
    };
    let tiles = built.delta.tiles.iter();
    tiles.flat_map(|(id, evidence)| evidence.cells.iter().map(|cell| position(id, cell))).collect()
}

#[test]
fn what_is_twenty_metres_east_lands_twenty_metres_east() {
    let result = built(drive(AUSTIN, 21)).unwrap();
    assert_eq!((result.delta.detections, result.dropped), (21, Dropped::default()));
    let grid = Grid::of(AUSTIN).unwrap();
    let east =
        LatLon { lon_deg: AUSTIN.lon_deg + 20.0 / (111_320.0 * AUSTIN.lat_deg.to_radians().cos()), ..AUSTIN };
    let expected = grid.project(east).unwrap();
    let nearest = hit_positions(&result).into_iter().map(|p| p.distance_m(expected)).fold(9e9, f64::min);
    // The degree of longitude above is good to a few centimetres here.
    assert!(nearest < 0.1, "{nearest}");
}

#[test]
fn near_a_border_both_zones_hold_the_same_positions() {
    let at = LatLon { lat_deg: 51.0, lon_deg: 5.999 };
    let result = built(drive(at, 21)).unwrap();
    assert_eq!(result.delta.detections, 21);
    let hits = |epsg| -> u32 {
        let tiles = result.delta.tiles.iter().filter(|(id, _)| id.zone.epsg() == epsg);
        tiles.flat_map(|(_, evidence)| &evidence.cells).map(|cell| cell.hits).sum()
    };
    assert_eq!((hits(32631), hits(32632)), (21, 21));
}

#[test]
fn what_is_left_out_is_counted_by_its_reason() {
    let mut upload = drive(AUSTIN, 41);
    let chunk = &mut upload.chunks[0];
    chunk.scans[1].range_m[0] = 60.0;
    chunk.scans[2].radial_speed_mps = vec![7.0];
    chunk.scans[40].time_us += 1;
    chunk.poses[10].sigma_yaw_rad = 0.1;
    for i in 20..30 {
        chunk.poses[i].at = chunk.poses[20].at;
    }
    let result = built(upload).unwrap();
    // The car stands still from 20 to 29, then its positioning jumps on.
    let expected = Dropped { too_far: 1, moving: 1, without_pose: 2, too_slow: 10, ..Dropped::default() };
    assert_eq!(result.dropped, expected);
    assert_eq!(result.delta.detections + expected.total(), 41);
}

#[test]
fn the_error_is_the_main_reason_when_nothing_counts() {
    let error_of = |change: fn(&mut Chunk)| {
        let mut upload = drive(AUSTIN, 21);
        change(&mut upload.chunks[0]);
        built(upload).unwrap_err()
    };
    assert!(matches!(
        error_of(|c| c.poses.iter_mut().for_each(|p| p.sigma_position_m = 0.31)),
        BuildError::PoseTooUncertain { .. }
    ));
    assert!(matches!(
        error_of(|c| c.poses.iter_mut().for_each(|p| p.at = AUSTIN)),
        BuildError::TooSlow { .. }
    ));
    assert!(matches!(error_of(|c| c.scans.clear()), BuildError::NoDetections { sent: 0 }));
    assert!(matches!(error_of(|c| c.poses.clear()), BuildError::NoDetections { sent: 21 }));
    assert!(matches!(
        error_of(|c| c.poses[0].at.lat_deg = 85.0),
        BuildError::Outside(geo::Error::OutsideUtm { .. })
    ));
    assert!(matches!(error_of(|c| c.scans[3].sensor = 4), BuildError::Scans(_)));
}

#[test]
fn an_upload_over_too_many_tiles_is_refused() {
    let limits = EvidenceLimits { max_tiles: 3, ..EvidenceLimits::default() };
    let error = build_evidence(drive(AUSTIN, 500), &limits).unwrap_err();
    assert!(matches!(error, BuildError::TooManyTiles { most: 3, .. }));
}

proptest! {
    #[test]
    fn neither_the_order_of_scans_nor_the_cut_into_chunks_matters(cut in 1..40_usize, turn in 0..41_usize) {
        let whole = drive(AUSTIN, 41);
        let expected = built(whole.clone()).unwrap();
        let Chunk { poses, mut scans } = whole.chunks[0].clone();
        let chunk = |poses: &[GeoPose], scans: &[Scan]| Chunk { poses: poses.to_vec(), scans: scans.to_vec() };
        // Both chunks cover the cut.
        let chunks = vec![chunk(&poses[..=cut], &scans[..cut]), chunk(&poses[cut..], &scans[cut..])];
        prop_assert_eq!(&built(RawUpload { chunks, ..whole.clone() }).unwrap(), &expected);
        scans.rotate_left(turn);
        let chunks = vec![chunk(&poses, &scans)];
        prop_assert_eq!(built(RawUpload { chunks, ..whole.clone() }).unwrap(), expected);
    }
}

/// The drive with twenty posts in each scan, their radial speeds as they should be, and then changed.
fn past_posts(edit: impl Fn(&mut GeoPose, &mut Scan)) -> Result<BuiltEvidence, BuildError> {
    let mut upload = drive(LatLon { lat_deg: 48.1, lon_deg: 11.6 }, 41);
    let Chunk { poses, scans } = &mut upload.chunks[0];
    for (pose, scan) in poses.iter_mut().zip(scans) {
        scan.azimuth_rad = (0..20).map(|post| 0.1 * post as f32 - 1.0).collect();
        scan.range_m = vec![20.0; 20];
        scan.radial_speed_mps = scan.azimuth_rad.iter().map(|a| -10.0 * a.cos()).collect();
        edit(pose, scan);
    }
    built(upload)
}

/// Catches an upload in another convention that is mapped from, and one that is refused without asking for it.
#[test]
fn uploads_in_another_convention_are_refused_and_asked_for_it() {
    assert_eq!(past_posts(|_, _| ()).unwrap().delta.detections, 41 * 20);
    let speeds = |change: fn(f32) -> f32| {
        move |_: &mut GeoPose, scan: &mut Scan| {
            scan.radial_speed_mps.iter_mut().for_each(|v| *v = change(*v));
        }
    };
    let refused = |result: Result<BuiltEvidence, BuildError>| result.unwrap_err().to_string();
    let text = refused(past_posts(speeds(|v| -v)));
    assert_eq!(
        text,
        "100 % of the returns were dropped as moving: is the radial speed positive away from the sensor?"
    );
    assert!(refused(past_posts(speeds(|v| 3.6 * v))).ends_with("in metres per second, not in km/h?"));
    assert!(refused(past_posts(speeds(|_| 0.01))).ends_with("with the vehicle's own motion still in it?"));
    let degrees = past_posts(|_, scan| scan.azimuth_rad.iter_mut().for_each(|a| *a = a.to_degrees()));
    assert!(refused(degrees).ends_with("is the azimuth in radians, not in degrees?"));
    let from_north = |pose: &mut GeoPose| pose.yaw_rad = std::f64::consts::FRAC_PI_2 - pose.yaw_rad;
    let text = refused(past_posts(|pose, _| from_north(pose)));
    assert!(text.contains("not clockwise from north?"), "{text}");
    // A radar without radial speeds has no movers.
    let silent = past_posts(|pose, scan| {
        from_north(pose);
        scan.radial_speed_mps.clear();
    });
    assert!(matches!(silent, Err(BuildError::WrongConvention(_))), "{silent:?}");
    let swapped =
        past_posts(|pose, _| pose.at = LatLon { lat_deg: pose.at.lon_deg, lon_deg: pose.at.lat_deg });
    assert!(refused(swapped).contains("are latitude and longitude exchanged?"));
}

/// Catches a refusal of what is only traffic, as long as more stands than moves.
#[test]
fn traffic_is_left_out_and_the_rest_counts() {
    let jam = past_posts(|_, scan| scan.radial_speed_mps[..9].fill(0.0));
    let BuiltEvidence { delta, dropped, .. } = jam.unwrap();
    assert_eq!((delta.detections, dropped.moving), (41 * 11, 41 * 9));
}
