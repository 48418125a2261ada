//! Work ends when its caller does.

use std::time::{Duration, Instant};

use echofix_core::align::Search;
use echofix_core::align::verdict::Integrity;
use tokio::sync::Semaphore;

use super::*;
use crate::http::testing::{FakeStore, austin};
use crate::shares::{Peer, Pool};

/// Tiles along the side of a town.
const SIDE: i32 = 24;

/// A town full of posts, and a route through all of its tiles.
fn town() -> (Arc<FakeStore>, Vec<LatLon>) {
    let side = CELLS_PER_TILE as u32;
    let posts: Vec<(u32, u32)> = (0..600).map(|i| i * 7_919 % (side * side)).map(|at| (at, 2)).collect();
    let mut posts = posts;
    posts.sort_unstable();
    posts.dedup();
    let tile = |i: i32| TileId { x: austin().x + i % SIDE, y: austin().y + i / SIDE, ..austin() };
    let tiles: Vec<_> = (0..SIDE * SIDE).map(tile).collect();
    let filled: Vec<_> = tiles.iter().map(|id| (*id, &posts[..])).collect();
    let grid = Grid::new(austin().zone).unwrap();
    let middle = |id: &TileId| grid.unproject(id.origin().moved(10.0, 10.0)).unwrap();
    (Arc::new(FakeStore::with_tiles(&filled)), tiles.iter().map(middle).collect())
}

/// Catches: seconds of work for a caller that went away after 50 ms, and everybody else behind it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn work_ends_with_its_caller() {
    let (store, route) = town();
    let known: Arc<dyn MapStore> = store;
    let expectations =
        Arc::new(Expectations::new(Arc::clone(&known), Search::default(), Integrity::default()));
    let permits = Arc::new(Semaphore::new(8));
    let asked = || {
        let request = GetCoverageRequest {
            latitude_deg: route.iter().map(|at| at.lat_deg).collect(),
            longitude_deg: route.iter().map(|at| at.lon_deg).collect(),
            expectations: true,
        };
        let permit = Arc::clone(&permits).try_acquire_owned().unwrap();
        get_coverage(
            (Arc::clone(&known), Arc::clone(&expectations), DemandPolicy::default()),
            request,
            (permit, (Pool::new(1, 1.0).take(Peer::unknown()).unwrap(), None)),
        )
    };
    // Several, of which one works and the others wait for it.
    let calls: Vec<_> = (0..8).map(|_| tokio::spawn(asked())).collect();
    tokio::time::sleep(Duration::from_millis(50)).await;
    assert_eq!(permits.available_permits(), 0, "there is work for longer than that");
    calls.iter().for_each(tokio::task::JoinHandle::abort);
    let gone = Instant::now();
    let _all = permits.acquire_many(8).await.unwrap();
    // A step takes some milliseconds, and far longer beside all other tests. Without an end it is the better part of a minute.
    assert!(gone.elapsed() < Duration::from_secs(15), "the work went on for {:?}", gone.elapsed());
}
