//! Services that name each other.

use super::*;
use crate::service::ServiceAddress;
use crate::testing::T0;
use crate::testing::service::{Behaviour, MockService};
use crate::vehicle::{LocalizationQuestion, Vehicle, VehicleConfig};
use crate::{Localizer, LocalizerOptions};
use echofix_core::drive::GeoPose;
use echofix_core::pose::Pose2;
use echofix_core::scan::{Mount, Scan};

fn question() -> LocalizationQuestion {
    let mut vehicle = Vehicle::new(VehicleConfig::default(), vec![Mount::IDENTITY]);
    for i in 0..20 {
        let time_us = T0 + i * 100_000;
        vehicle.push_odometry(time_us, Pose2::new(i as f64, 0.0, 0.0)).unwrap();
        let scan = Scan { time_us, range_m: vec![9.0], azimuth_rad: vec![0.1], ..Scan::default() };
        vehicle.push_scan(scan).unwrap();
    }
    let pose = GeoPose { time_us: T0 + 1_000_000, sigma_position_m: 3.0, ..GeoPose::default() };
    vehicle.push_pose(pose).unwrap();
    vehicle.question().unwrap()
}

async fn two() -> (MockService, MockService, Localizer) {
    let (home, other) = (MockService::start(Vec::new()).await, MockService::start(Vec::new()).await);
    let address = ServiceAddress { replicas: vec![other.url()], ..ServiceAddress::at(home.url()) };
    let localizer = Localizer::new(address.endpoint().unwrap(), LocalizerOptions::default());
    (home, other, localizer)
}

/// Catches: a vehicle that does not follow, follows for other regions, or asks two services where one answers.
#[tokio::test]
async fn a_region_is_asked_where_an_answer_says() {
    let (home, other, localizer) = two().await;
    home.name_better(Some(&other.url()));
    for _ in 0..4 {
        localizer.ask(&question()).await.unwrap();
    }
    assert_eq!((home.call_times().len(), other.call_times().len()), (1, 3));
    let region = region_of(&question().request).unwrap();
    assert!(other.regions().iter().all(|named| *named == Some(region.to_string())));
    let elsewhere = RoutingRegion::of(LatLon { lat_deg: 48.0, lon_deg: 11.0 }).unwrap();
    assert!(localizer.router().ask(Some(elsewhere)).replica.is_none());
    assert!(localizer.router().ask(None).replica.is_none());
}

/// Catches: replicas that send a vehicle to and fro, each of them naming the other.
#[tokio::test]
async fn replicas_that_disagree_are_answered_by_and_not_followed_to_and_fro() {
    let (home, other, localizer) = two().await;
    home.name_better(Some(&other.url()));
    other.name_better(Some(&home.url()));
    for _ in 0..6 {
        localizer.ask(&question()).await.unwrap();
    }
    assert_eq!((home.call_times().len(), other.call_times().len()), (1, 5), "one change in ten seconds");
}

/// Catches: a question that is lost because a replica which was named is gone or hangs, and one that is asked there again at once.
#[tokio::test]
async fn a_replica_that_does_not_answer_is_left() {
    let hanging = MockService::start(vec![Behaviour::Hang]).await;
    let nobody = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    for gone in [hanging.url(), format!("http://{nobody}")] {
        let home = MockService::start(Vec::new()).await;
        home.name_better(Some(&gone));
        let address = ServiceAddress { replicas: vec![gone], ..ServiceAddress::at(home.url()) };
        let localizer = Localizer::new(address.endpoint().unwrap(), LocalizerOptions::default());
        let mut stream = localizer.stream();
        for _ in 0..4 {
            localizer.ask(&question()).await.unwrap();
            stream.ask(&question()).await.unwrap();
        }
        // Four and four; the stream is made once.
        assert_eq!(home.call_times().len(), 8);
    }
}

/// Catches: a stream that stays where its batches are not kept warm, and one that loses a question on the way.
#[tokio::test]
async fn a_stream_moves_to_the_replica() {
    let (home, other, localizer) = two().await;
    home.name_better(Some(&other.url()));
    let mut stream = localizer.stream();
    for _ in 0..3 {
        stream.ask(&question()).await.unwrap();
    }
    assert_eq!((home.call_times().len(), other.call_times().len()), (1, 2));
}

/// Catches: questions that go to whomever an answer names, and a memory that grows with the places.
#[tokio::test]
async fn only_what_is_vouched_for_is_followed_and_little_is_remembered() {
    let (home, _, localizer) = two().await;
    let stranger = MockService::start(Vec::new()).await;
    home.name_better(Some(&stranger.url()));
    localizer.ask(&question()).await.unwrap();
    localizer.ask(&question()).await.unwrap();
    assert_eq!((home.call_times().len(), stranger.call_times().len()), (2, 0));

    let all: Vec<_> = (0..100).map(|at| format!("http://127.0.0.1:{}", 1000 + at)).collect();
    let address = ServiceAddress { replicas: all.clone(), ..ServiceAddress::at(home.url()) };
    let router = Router::new(address.endpoint().unwrap());
    for (at, replica) in all.iter().enumerate() {
        let region = RoutingRegion::of(LatLon { lat_deg: 48.0, lon_deg: at as f64 }).ok();
        let mut answer = MetadataMap::new();
        answer.insert(BETTER, replica.parse().unwrap());
        router.heard(region, &answer);
        answer.insert(BETTER, all[0].parse().unwrap());
        router.heard(RoutingRegion::of(LatLon { lat_deg: 40.0, lon_deg: at as f64 }).ok(), &answer);
    }
    let state = router.state();
    assert!(state.channels.len() == MOST_REPLICAS && state.regions.len() == MOST_REGIONS);
}

/// Catches: an upload that is sent to the replica of the place where it only began.
#[test]
fn an_upload_is_of_the_region_where_most_of_it_lies() {
    let at = |lat_deg: f64| TileId::at(LatLon { lat_deg, lon_deg: 11.0 }).unwrap();
    let region = |lat_deg: f64| region_at(LatLon { lat_deg, lon_deg: 11.0 });
    assert_eq!(region_of_most([(at(48.0), 3), (at(49.0), 5), (at(48.0), 1)]), region(49.0));
    assert_eq!(region_of_most([]), None);
}
