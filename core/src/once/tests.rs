//! A vehicle in a small street. That the pose is found is the example of the crate's documentation.

use super::*;
use crate::align::engine::{Candidate, EngineWorkspace, SearchQuestion};
use crate::align::verdict::Verdict;
use crate::pose::Pose2;

const SPEED_MPS: f64 = 8.0;

/// Two fronts.
fn street() -> Vec<MapPoint> {
    let front = |side: f64| {
        (0..900).map(move |i| {
            let along = 0.1 * f64::from(i);
            MapPoint::new(along, side * (9.0 + 1.5 * (0.7 * along + side).sin() + (1.9 * along).cos()))
        })
    };
    front(1.0).chain(front(-1.0)).collect()
}

fn true_pose(time_us: i64) -> Pose2 {
    Pose2::new(20.0 + SPEED_MPS * 1e-6 * time_us as f64, 0.5, 0.0)
}

fn odometry() -> Trajectory {
    let poses = (0..=50).map(|i| (i * 100_000, Pose2::new(SPEED_MPS * 0.1 * i as f64, 0.0, 0.0)));
    Trajectory::new(poses).expect("times increase")
}

/// What one radar at the body's origin sees, every tenth of a second.
fn scans() -> Vec<Scan> {
    let street = street();
    let scan = |i: i64| {
        let body = true_pose(i * 100_000).inverse();
        let seen = street.iter().skip(i as usize % 3).step_by(3).map(|p| body.transform((*p).into()));
        let seen: Vec<_> = seen.filter(|[x, y]| x.hypot(*y) < 45.0).collect();
        Scan {
            time_us: i * 100_000,
            range_m: seen.iter().map(|[x, y]| x.hypot(*y) as f32).collect(),
            azimuth_rad: seen.iter().map(|[x, y]| y.atan2(*x) as f32).collect(),
            ..Scan::default()
        }
    };
    (0..=50).map(scan).collect()
}

fn prior() -> Prior {
    let truth = true_pose(5_000_000);
    let pose = Pose2::new(truth.x_m + 1.2, truth.y_m - 0.8, 0.03);
    Prior { pose, sigma_position_m: 1.0, sigma_yaw_rad: 0.03, scale: 1.0 }
}

fn asked(
    map: &[MapPoint],
    scans: &[Scan],
    prior: &Prior,
    options: &OnceOptions<'_>,
) -> Result<Alignment, Error> {
    align_once(
        map,
        &VehicleScans { scans, mounts: &[Mount::IDENTITY], odometry: &odometry() },
        prior,
        options,
    )
}

/// Catches map points that lose their position in their cell, and tiles without their neighbours' borders.
#[test]
fn the_pose_is_found_anywhere_on_the_plane() {
    for [east, north] in [[0.0, 0.0], [-40.0, -3.0], [600_000.0, 3_300_000.0]] {
        let map: Vec<_> = street().into_iter().map(|p| p.moved(east, north)).collect();
        let mut prior = prior();
        (prior.pose.x_m, prior.pose.y_m) = (prior.pose.x_m + east, prior.pose.y_m + north);
        let found = asked(&map, &scans(), &prior, &OnceOptions::default()).expect("there is a map");
        let truth = true_pose(5_000_000);
        let truth = Pose2::new(truth.x_m + east, truth.y_m + north, truth.yaw_rad);
        assert!(found.pose.distance_m(&truth) < 0.1, "{found:?}");
    }
}

/// An engine of a caller: it tries the prior and nothing else, and takes it for the edge of a search.
struct PriorOnly;

impl Engine for PriorOnly {
    fn name(&self) -> &'static str {
        "prior only"
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        *workspace.buffers::<usize>() += questions.len();
        for candidates in candidates {
            candidates.clear();
            candidates.push(Candidate { correction: Pose2::IDENTITY, score: 0.0, at_edge: true });
        }
    }
}

/// Catches a pipeline that asks an engine of its own instead of the caller's: the same question would be
/// answered with other candidates and a pose that may be used.
#[test]
fn a_callers_own_engine_drives_the_pipeline() {
    let options = OnceOptions { engine: &PriorOnly, ..OnceOptions::default() };
    let found = asked(&street(), &scans(), &prior(), &options).expect("there is a map");
    assert_eq!(found.verdict, Verdict::PriorOutsideSearch, "{found:?}");
    assert!(found.alternatives.is_empty(), "{found:?}");
}

/// Catches input that panics, or is answered as if it were sound.
#[test]
fn what_cannot_be_aligned_is_an_error_that_says_what_to_do() {
    let (map, scans, options) = (street(), scans(), OnceOptions::default());
    let error = |map: &[MapPoint], scans: &[Scan], prior: &Prior| {
        asked(map, scans, prior, &options).expect_err("it cannot be aligned")
    };
    let with = |change: fn(&mut Prior)| {
        let mut prior = prior();
        change(&mut prior);
        prior
    };
    assert_eq!(error(&map, &[], &prior()), Error::NoScans);
    assert_eq!(error(&map, &scans, &with(|p| p.pose.x_m = f64::NAN)), Error::PriorPose);
    let zero = error(&map, &scans, &with(|p| p.scale = 0.0));
    assert_eq!(zero, Error::PriorNotPositive { field: "scale", value: 0.0 });
    let wide = error(&map, &scans, &with(|p| p.sigma_position_m = 50.0));
    assert_eq!(wide, Error::SearchTooWide { search_m: 150.0 });
    let far = error(&map, &scans, &with(|p| p.pose.x_m = 1e6));
    assert!(far.to_string().contains("same map metres"), "{far}");
    assert!(matches!(
        error(&[MapPoint::new(f64::NAN, 0.0)], &scans, &prior()),
        Error::MapPoint { index: 0, .. }
    ));
    let short = Scan { range_m: vec![1.0], ..Scan::default() };
    assert!(matches!(error(&map, &[short], &prior()), Error::Scan { index: 0, .. }));
    let elsewhere = Scan { sensor: 1, ..scans[0].clone() };
    assert!(matches!(error(&map, &[elsewhere], &prior()), Error::Batch(_)));
    let far = Scan { range_m: vec![70.0], azimuth_rad: vec![0.0], ..Scan::default() };
    let nothing = error(&map, &[far], &prior());
    assert!(nothing.to_string().contains("1 too far"), "{nothing}");
}
