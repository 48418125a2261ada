//! Reading the map: by area, by id, what changed only; coverage; and the border of two zones.

use std::collections::BTreeSet;

use echofix_core::geo::{LatLon, TileId};
use echofix_harness::truth::AnswerError;
use echofix_proto::v1::get_tiles_request::Selection;
use echofix_proto::v1::{FixStatus, GeodeticBox, GetCoverageRequest, TileList, TileVersion};
use echofix_tests::asking::{error, percentile, requests};
use echofix_tests::service::Service;
use echofix_tests::tiles::{self, EVERYWHERE, Tiles};
use echofix_tests::world::World;
use echofix_tests::{grpc, mapping, town};
use tokio::sync::OnceCell;

async fn world() -> &'static World {
    static WORLD: OnceCell<World> = OnceCell::const_new();
    WORLD.get_or_init(World::mapped).await
}

fn list(ids: impl IntoIterator<Item = TileId>) -> Selection {
    Selection::Tiles(TileList { ids: ids.into_iter().map(tiles::message).collect() })
}

fn versions(tiles: &Tiles) -> Vec<TileVersion> {
    tiles
        .iter()
        .map(|(id, (version, _))| TileVersion { tile: Some(tiles::message(*id)), version: *version })
        .collect()
}

/// Catches tiles that are left out, sent damaged, or not those the uploads' answers named.
#[tokio::test(flavor = "multi_thread")]
async fn an_area_gives_every_tile_that_touches_it_and_ids_give_the_same() {
    let world = world().await;
    let mut client = grpc::reading(&world.service).await;
    let (all, summary) = tiles::get(&mut client, Selection::Area(EVERYWHERE), Vec::new()).await.unwrap();
    let named: BTreeSet<TileId> =
        world.answers.iter().flat_map(|a| &a.tiles).map(|t| tiles::id(t.tile.as_ref().unwrap())).collect();
    assert_eq!(all.keys().copied().collect::<BTreeSet<_>>(), named);
    assert_eq!((summary.epoch, summary.unchanged, summary.absent.len()), (world.answers.len() as u64, 0, 0));
    for (id, (_, encoded)) in &all {
        let tile = echofix_core::tile::decode(encoded).unwrap_or_else(|error| panic!("tile {id}: {error}"));
        assert!(!tile.is_empty(), "tile {id}");
    }
    let (by_id, _) = tiles::get(&mut client, list(all.keys().copied()), Vec::new()).await.unwrap();
    assert_eq!(by_id, all);

    // The middle of the town, a few metres wide: one to four tiles.
    let LatLon { lat_deg, lon_deg } = world.city.site().origin();
    let small = GeodeticBox {
        south_deg: lat_deg - 1e-5,
        north_deg: lat_deg + 1e-5,
        west_deg: lon_deg - 1e-5,
        east_deg: lon_deg + 1e-5,
    };
    let (few, _) = tiles::get(&mut client, Selection::Area(small), Vec::new()).await.unwrap();
    assert!(
        (1..=4).contains(&few.len()) && few.iter().all(|(id, tile)| all.get(id) == Some(tile)),
        "{}",
        few.len()
    );
    let elsewhere = GeodeticBox { south_deg: 10.0, north_deg: 11.0, west_deg: 170.0, east_deg: -170.0 };
    let (none, summary) = tiles::get(&mut client, Selection::Area(elsewhere), Vec::new()).await.unwrap();
    assert!(none.is_empty() && summary.sent == 0);
}

/// Catches a cache that is sent all again, or believes what is no longer true.
#[tokio::test(flavor = "multi_thread")]
async fn only_what_changed_is_sent_to_a_caller_that_has_the_rest() {
    let seed = town::seed();
    let city = town::town(seed);
    let uploads = mapping::uploads(&town::wander(&city, 0, "mapper", seed, 400.0));
    let (last, first) = uploads.split_last().expect("the drive makes uploads");
    let service = Service::start();
    let (mut sender, mut client) = (grpc::mapping(&service).await, grpc::reading(&service).await);
    for upload in first {
        mapping::send(&mut sender, upload.parts()).await.expect("the upload counts");
    }
    mapping::folded(&service).await;
    let area = || Selection::Area(EVERYWHERE);
    let (mut cached, _) = tiles::get(&mut client, area(), Vec::new()).await.unwrap();
    let (none, summary) = tiles::get(&mut client, area(), versions(&cached)).await.unwrap();
    assert!(none.is_empty() && summary.unchanged as usize == cached.len());

    let answer = mapping::send(&mut sender, last.parts()).await.expect("the upload counts");
    mapping::folded(&service).await;
    let (changed, summary) = tiles::get(&mut client, area(), versions(&cached)).await.unwrap();
    let named: BTreeSet<_> = answer.tiles.iter().map(|t| tiles::id(t.tile.as_ref().unwrap())).collect();
    assert_eq!(
        changed.keys().copied().collect::<BTreeSet<_>>(),
        named,
        "just the tiles that the upload's answer named"
    );
    let newer =
        |(id, (version, _)): (&TileId, &(u64, _))| cached.get(id).is_none_or(|(old, _)| old != version);
    assert!(changed.iter().all(newer));
    let unchanged = cached.keys().filter(|id| !named.contains(id)).count();
    assert_eq!(summary.unchanged as usize, unchanged);
    cached.extend(changed);
    assert_eq!(cached, tiles::all(&service).await, "a caller that follows the changes has the whole map");
}

/// Catches a tile that is not there and silently left out, or a limit that is not enforced.
#[tokio::test(flavor = "multi_thread")]
async fn tiles_that_do_not_exist_are_named_and_senseless_questions_refused() {
    let world = world().await;
    let mut client = grpc::reading(&world.service).await;
    let known = tiles::id(world.answers[0].tiles[0].tile.as_ref().unwrap());
    let missing = TileId { y: known.y + 500, ..known };
    let held = TileId { y: known.y - 500, ..known };
    let have = vec![TileVersion { tile: Some(tiles::message(held)), version: 1 }];
    let (found, summary) = tiles::get(&mut client, list([known, missing]), have).await.unwrap();
    assert_eq!(found.keys().collect::<Vec<_>>(), [&known]);
    let absent: BTreeSet<_> = summary.absent.iter().map(tiles::id).collect();
    assert_eq!(absent, BTreeSet::from([missing, held]));

    let not_utm = TileList { ids: vec![echofix_proto::v1::TileId { epsg: 4326, x: 0, y: 0 }] };
    let nan = GeodeticBox { south_deg: f64::NAN, ..EVERYWHERE };
    let upside_down = GeodeticBox { south_deg: 2.0, north_deg: 1.0, ..EVERYWHERE };
    for (selection, field) in [
        (Selection::Tiles(not_utm), "tiles.ids[0].epsg"),
        (list(vec![known; 1025]), "tiles.ids"),
        (Selection::Area(nan), "area.south_deg"),
        (Selection::Area(upside_down), "area.north_deg"),
    ] {
        let status = tiles::get(&mut client, selection, Vec::new()).await.expect_err("it is refused");
        assert_eq!(grpc::field(&status), field);
    }
}

/// A route of so many points where it was driven, then north of it where nobody was, and beyond UTM.
fn mapped_and_unknown(world: &World, expectations: bool) -> (usize, GetCoverageRequest) {
    let mapped: Vec<LatLon> = world.visit(300.0).truth.iter().step_by(40).map(|pose| pose.at).collect();
    let unknown = [0.02, 54.5].map(|north| LatLon { lat_deg: mapped[0].lat_deg + north, ..mapped[0] });
    let route: Vec<LatLon> = mapped.iter().copied().chain(unknown).collect();
    let request = GetCoverageRequest {
        latitude_deg: route.iter().map(|at| at.lat_deg).collect(),
        longitude_deg: route.iter().map(|at| at.lon_deg).collect(),
        expectations,
    };
    (mapped.len(), request)
}

/// Catches coverage that is counted at the wrong position or of the wrong day.
#[tokio::test(flavor = "multi_thread")]
async fn coverage_tells_the_mapped_road_from_the_unknown() {
    let world = world().await;
    let mut client = grpc::reading(&world.service).await;
    let (mapped, request) = mapped_and_unknown(world, false);
    let rows = request.latitude_deg.len();
    let coverage = client.get_coverage(request).await.unwrap().into_inner();
    assert_eq!(coverage.epoch, world.answers.len() as u64);
    assert_eq!((coverage.cells.len(), coverage.newest_day.len()), (rows, rows));
    let (on, off) = coverage.cells.split_at(mapped);
    assert!(on.iter().all(|cells| *cells > 1_000) && off == [0, 0], "{coverage:?}");
    let (on, off) = coverage.newest_day.split_at(mapped);
    assert!(on.iter().all(|day| *day == 20_454) && off == [0, 0], "{coverage:?}");

    let refused = |rows: usize, others: usize, expectations| GetCoverageRequest {
        latitude_deg: vec![1.0; rows],
        longitude_deg: vec![1.0; others],
        expectations,
    };
    for (request, field) in
        [(refused(2, 1, false), "longitude_deg"), (refused(1025, 1025, true), "latitude_deg")]
    {
        let status = client.get_coverage(request).await.expect_err("it is refused");
        assert_eq!(grpc::field(&status), field);
    }
}

/// Catches expectations of the wrong position, without a map they rest on, or that come unasked.
#[tokio::test(flavor = "multi_thread")]
async fn a_route_is_told_where_fixes_can_be_expected() {
    let world = world().await;
    let mut client = grpc::reading(&world.service).await;
    let (mapped, request) = mapped_and_unknown(world, true);
    let coverage = client.get_coverage(request.clone()).await.unwrap().into_inner();
    let (on, off) = coverage.expected.split_at(mapped);
    assert!(off.iter().all(|fix| fix.status() == FixStatus::TooLittleMap && fix.version == 0), "{off:?}");
    let usable = on.iter().filter(|fix| fix.status() == FixStatus::Usable).count();
    assert!(usable * 10 >= on.len() * 8, "{usable} of {}", on.len());
    let tiles = tiles::all(&world.service).await;
    let versions: BTreeSet<u64> = tiles.values().map(|(version, _)| *version).collect();
    for fix in on.iter().filter(|fix| fix.status() == FixStatus::Usable) {
        assert!(fix.weakest_sigma_m >= fix.strongest_sigma_m && fix.strongest_sigma_m > 0.05, "{fix:?}");
        assert!(fix.weakest_sigma_m < 0.5 && fix.margin >= 12.0 && fix.sigma_yaw_rad < 0.02, "{fix:?}");
        assert!(versions.contains(&fix.version), "{fix:?} is of none of the versions {versions:?}");
    }
    let again = client.get_coverage(request.clone()).await.unwrap().into_inner();
    assert_eq!(again, coverage);
    let unasked = GetCoverageRequest { expectations: false, ..request };
    assert!(client.get_coverage(unasked).await.unwrap().into_inner().expected.is_empty());
}

/// Catches a pose that is laid out or answered on the wrong zone's grid, or without its convergence: the
/// town lies across 6 degrees east, where zone 31 meets zone 32, and a vehicle asks from either side.
#[tokio::test(flavor = "multi_thread")]
async fn a_town_on_a_zone_border_is_one_map_from_either_side() {
    let seed = town::seed();
    let city = town::town_at(seed, LatLon { lat_deg: 51.0, lon_deg: 6.0 });
    let service = Service::start();
    mapping::contribute(&service, &town::survey(&city, 0, "mapper", seed)).await;
    let mut client = grpc::localizing(&service).await;
    let drive = town::survey(&city, 3, "visitor", seed + 1);
    // Errors by the zone that answered.
    let (mut west, mut east) = (Vec::new(), Vec::new());
    let (mut asked, mut across) = (0, 0);
    for case in requests(&drive, 3.0, seed) {
        let prior = case.request.prior.as_ref().unwrap().pose.unwrap();
        let answer = client.localize(case.request.clone()).await.expect("there is a map").into_inner();
        let errors = match answer.utm.unwrap().epsg {
            32631 => &mut west,
            32632 => &mut east,
            other => panic!("EPSG {other} is not of this border"),
        };
        assert_eq!(answer.utm.unwrap().epsg == 32632, prior.longitude_deg >= 6.0, "the prior's zone answers");
        asked += 1;
        if answer.status() == FixStatus::Usable {
            errors.push(error(&answer.pose.unwrap(), &case.truth));
            across += u32::from((prior.longitude_deg >= 6.0) != (case.truth.at.lon_deg >= 6.0));
        }
    }
    eprintln!(
        "{asked} asked, usable: {} in the west, {} in the east, {across} from across",
        west.len(),
        east.len()
    );
    assert!(west.len() >= 5 && east.len() >= 5 && (west.len() + east.len()) * 10 >= asked * 6);
    for errors in [&west, &east] {
        let error_95 = percentile(errors.iter().map(AnswerError::horizontal_m), 0.95);
        let yaw_95 = percentile(errors.iter().map(|e| e.yaw_rad.abs().to_degrees()), 0.95);
        // A forgotten convergence would be 4.7 degrees between the zones here.
        assert!(error_95 < 0.44 && yaw_95 < 0.59, "{error_95:.3} m, {yaw_95:.3} deg");
    }
}

/// Catches two zones' maps that differ, as when what is seen from one side is stored in that
/// side's zone only: the same batch, asked from a prior on either side of the border, meets as much
/// of a map and is answered with the same pose.
#[tokio::test(flavor = "multi_thread")]
async fn a_step_over_the_border_moves_nothing() {
    let seed = town::seed();
    let city = town::town_at(seed, LatLon { lat_deg: 51.0, lon_deg: 6.0 });
    let service = Service::start();
    mapping::contribute(&service, &town::survey(&city, 0, "mapper", seed)).await;
    let mut client = grpc::localizing(&service).await;
    let drive = town::survey(&city, 3, "visitor", seed + 1);
    let mut compared = 0;
    let near =
        |case: &echofix_tests::asking::TruthRequest| (case.truth.at.lon_deg - 6.0).abs() * 70_000.0 < 3.0;
    for case in requests(&drive, 0.2, seed).into_iter().filter(near).take(6) {
        let mut answers = Vec::new();
        for step_deg in [-2e-5, 2e-5] {
            let mut request = case.request.clone();
            let pose = request.prior.as_mut().unwrap().pose.as_mut().unwrap();
            (pose.latitude_deg, pose.longitude_deg) = (case.truth.at.lat_deg, 6.0 + step_deg);
            answers.push(client.localize(request).await.expect("there is a map").into_inner());
        }
        let zones: Vec<u32> = answers.iter().map(|a| a.utm.unwrap().epsg).collect();
        assert_eq!(zones, [32631, 32632]);
        let [west, east] = [0, 1].map(|i: usize| answers[i].map.unwrap());
        // The windows are squares of either grid, turned against each other by 5 degrees.
        let ratio = f64::from(west.cells) / f64::from(east.cells);
        assert!(
            (0.9..1.1).contains(&ratio) && (west.coverage - east.coverage).abs() < 0.02,
            "{west:?} {east:?}"
        );
        if answers.iter().all(|answer| answer.status() == FixStatus::Usable) {
            let [west, east] = [0, 1].map(|i: usize| error(&answers[i].pose.unwrap(), &case.truth));
            let apart_m = (west.along_m - east.along_m).hypot(west.cross_m - east.cross_m);
            assert!(
                apart_m < 0.1 && (west.yaw_rad - east.yaw_rad).abs().to_degrees() < 0.2,
                "{west:?} {east:?}"
            );
            compared += 1;
        }
    }
    assert!(compared >= 2, "only {compared} pairs of usable answers");
}
