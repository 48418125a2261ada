//! The sampled check: what agrees with the exact engine and what does not is counted.

use echofix_core::evidence::{Cell, presence};
use echofix_core::geo::{CellIndex, Grid, LatLon, TileId};
use echofix_core::point::{BodyPoint, MapPoint};
use echofix_core::pose::Pose2;
use echofix_core::tile::Tile;
use echofix_sim::rng::{Purpose, normal, stream};

use super::*;
use crate::config::{Config, Sources};
use crate::http::testing::FakeStore;
use crate::locating::LocatingConfig;

const AUSTIN: LatLon = LatLon { lat_deg: 30.2672, lon_deg: -97.7431 };

/// Posts around a body that looks east, metres on the grid.
fn posts() -> Vec<[f64; 2]> {
    let mut rng = stream(7, Purpose::Furniture, 0, 0);
    (0..900).map(|_| [normal(&mut rng, 15.0), normal(&mut rng, 15.0)]).collect()
}

/// A map of the posts around a position.
fn map(grid: &Grid, position: MapPoint) -> FakeStore {
    let mut tiles = std::collections::BTreeMap::<TileId, std::collections::BTreeMap<u32, Cell>>::new();
    for [dx, dy] in posts() {
        let (id, index) = TileId::locate(grid.zone(), CellIndex::of(position.moved(dx, dy)));
        let middle = Cell {
            hits: 1,
            passes: 1,
            contributors: 1,
            presence: presence::ALWAYS,
            offset_sum: [128, 128],
            ..Cell::default()
        };
        tiles.entry(id).or_default().insert(index, middle);
    }
    let store = FakeStore::default();
    for (id, cells) in tiles {
        store.put(id, Tile::from_cells(cells.into_iter().collect()).unwrap());
    }
    store
}

/// The service over that map, and a request from a metre beside the truth.
fn service_and_request() -> (Localization, LocateRequest) {
    let grid = Grid::of(AUSTIN).unwrap();
    let store = Arc::new(map(&grid, grid.project(AUSTIN).unwrap()));
    let locator = Arc::new(Locator::new(store, Config::load(&Sources::default()).unwrap().locating));
    let inner = Localization::new(locator, Arc::default(), Arc::default());
    let points: Vec<_> = posts().iter().map(|[x, y]| BodyPoint::new(*x as f32, *y as f32)).collect();
    let batch = Batch { detections: points.len() as u64, points, speed_mps: 10.0, ..Batch::default() };
    let beside = Pose2::new(0.8, -0.6, 0.0);
    let truth = grid.pose_from_geodetic(AUSTIN, grid.convergence_rad(AUSTIN).unwrap()).unwrap();
    let (at, yaw_rad) = grid.pose_to_geodetic(&truth.compose(&beside)).unwrap();
    let (position, yaw) = (0.25, 0.0004);
    let request = LocateRequest {
        batch,
        at,
        yaw_rad,
        covariance: [[position, 0.0, 0.0], [0.0, position, 0.0], [0.0, 0.0, yaw]],
        sigma_position_m: 0.5,
        sigma_yaw_rad: 0.02,
        combine: false,
        patience: Patience::default(),
        integrity_risk: None,
    };
    (inner, request)
}

/// How often the two agreed and differed when an answer, changed on the way, was asked again.
async fn checked(change: fn(&mut LocateAnswer)) -> [u64; 2] {
    let (inner, request) = service_and_request();
    let mut admitted = inner.locator.admit().await.unwrap();
    let mut answer = inner.locator.locate(&request, &mut admitted).unwrap();
    let back = answer.found.distance_m(&Pose2::new(-0.8, 0.6, 0.0));
    assert!(back < 0.1, "the answer leads back to the truth: {:?}", answer.found);
    change(&mut answer);
    inner.run_check(&SampledCheck { request, answer });
    ["agree", "differ"]
        .map(|outcome| inner.metrics.confirmations.get_or_create(&OutcomeLabel { outcome }).get())
}

/// Catches counters that are swapped or not counted, and a comparison with something else than what the
/// engines found.
#[tokio::test]
async fn an_answer_that_the_exact_engine_finds_too_is_counted_as_agreed() {
    assert_eq!(checked(|_| ()).await, [1, 0]);
    // What was made of it afterwards is not what the engines are compared by.
    assert_eq!(checked(|answer| answer.alignment.correction = Pose2::IDENTITY).await, [1, 0]);
}

/// Catches a fast engine whose misses are not counted: breaks when any two answers agree.
#[tokio::test]
async fn an_answer_on_another_maximum_is_counted_as_a_disagreement() {
    assert_eq!(checked(|answer| answer.found.x_m += 1.0).await, [0, 1]);
    assert_eq!(checked(|answer| answer.found.y_m -= 0.3).await, [0, 1]);
}

/// Catches a fraction that comes in bursts, or of everything or nothing.
#[tokio::test]
async fn the_answers_to_be_checked_are_evenly_spread() {
    let (inner, _) = service_and_request();
    let config = LocatingConfig { confirm_share: 0.25, ..*inner.locator.config() };
    let locator = Arc::new(Locator::new(Arc::new(FakeStore::default()), config));
    let inner = Localization { locator, ..inner };
    let sampled: Vec<bool> = (0..12).map(|_| inner.is_sampled()).collect();
    assert!(sampled.chunks(4).all(|four| four.iter().filter(|s| **s).count() == 1), "{sampled:?}");
}
