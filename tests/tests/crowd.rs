//! The crowd's map: what one vehicle alone says is not served, what is beside the map is kept out, and what is
//! taken back leaves no trace.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use echofix_client::upload::{Demand, PreparedUpload};
use echofix_core::drive::Drive;
use echofix_core::evidence::support_block;
use echofix_core::geo::{Grid, TileId};
use echofix_core::point::MapPoint;
use echofix_core::time::DAY_US;
use echofix_harness::recording::{record_wanted, to_the_ends};
use echofix_proto::v1::GetCoverageRequest;
use echofix_sim::City;
use echofix_tests::asking;
use echofix_tests::crowd::{bytes, cells, hits, quarantine, shifted, street, turned, upload};
use echofix_tests::mapping::{contribute, folded, send, uploads};
use echofix_tests::service::Service;
use echofix_tests::tiles::{self, Tiles};
use echofix_tests::{command, grpc, http, town, until_blocking};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use uuid::Uuid;

const THREE: &str = "mapping.publish_contributors=3";

fn the_town() -> City {
    town::town(town::seed())
}

/// Everybody in turn drives along the street, each on a day of his own.
async fn crowd(service: &Service, city: &City, vehicles: &[&str]) {
    for (day, vehicle) in (0..).zip(vehicles) {
        contribute(service, &street(city, day, vehicle)).await;
    }
}

/// Where a visitor of the street is, or why nobody can tell, question by question.
async fn visit(service: &Service, city: &City) -> Vec<String> {
    let questions = asking::requests(&street(city, 20, "visitor"), 8.0, 5);
    assert!(!questions.is_empty(), "the visitor asks");
    let mut client = grpc::localizing(service).await;
    let mut outcomes = Vec::new();
    for case in questions {
        outcomes.push(match client.localize(case.request).await {
            Ok(_) => "ANSWERED".to_owned(),
            Err(status) => grpc::reason(&status),
        });
    }
    outcomes
}

/// Why a visitor of the street gets no answer, in words.
async fn why_nowhere(service: &Service, city: &City) -> String {
    let questions = asking::requests(&street(city, 20, "visitor"), 8.0, 5);
    let case = questions.into_iter().next().expect("the visitor asks");
    let mut client = grpc::localizing(service).await;
    client.localize(case.request).await.expect_err("nothing is served").message().to_owned()
}

/// Catches: a count of uploads or of passes instead of contributors, and a limit that is one off.
#[tokio::test(flavor = "multi_thread")]
async fn a_street_is_served_from_the_third_contributor_on() {
    let city = the_town();
    let service = Service::start_with(&[THREE]);
    // One of them comes twice: still two.
    for (day, vehicle) in [(0, "anna"), (1, "boris"), (2, "anna")] {
        contribute(&service, &street(&city, day, vehicle)).await;
        let served = tiles::all(&service).await;
        assert_eq!(cells(&served).len(), 0, "day {day}: served before three contributors were there");
        assert!(served.is_empty(), "day {day}: tiles tell where somebody drove: {:?}", served.keys());
        let outcomes = visit(&service, &city).await;
        assert!(outcomes.iter().all(|word| word == "NO_MAP"), "day {day}: {outcomes:?}");
        // That is not "nobody was here".
        let seen = if day == 0 { "seen by 1 contributor," } else { "seen by 2 contributors," };
        let why = why_nowhere(&service, &city).await;
        assert!(why.contains(seen) && why.contains("once 3 have"), "day {day}: {why}");
    }
    contribute(&service, &street(&city, 3, "carla")).await;
    assert!(cells(&tiles::all(&service).await).len() > 1_000);
    let outcomes = visit(&service, &city).await;
    assert!(outcomes.iter().any(|word| word == "ANSWERED"), "{outcomes:?}");
}

/// Catches: a map that is empty, or a command that says all went well, without a word about what is missing; and a service that has
/// forgotten it after a restart.
#[tokio::test(flavor = "multi_thread")]
async fn why_a_street_is_not_served_is_told_wherever_one_looks() {
    let city = the_town();
    let mut service = Service::start_with(&[THREE]);
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("street.mcap");
    echofix_client::drivelog::write(&log, &street(&city, 0, "anna")).expect("the drive is written");
    let spool = folder.path().join("spool");
    let map = |more: &[&str]| {
        let (log, spool) = (log.to_str().unwrap(), spool.to_str().unwrap());
        command::echofix([&["map", log, "--server", &service.grpc, "--spool", spool][..], more].concat())
    };
    let mapped = map(&["--json"]).json();
    let served = &mapped["result"]["served"];
    assert!(served["tiles"].as_u64() > Some(2) && served["waiting"] == served["tiles"], "{served}");
    assert_eq!((&served["contributors"], &served["needed"]), (&json!(1), &json!(3)), "{served}");
    let told = map(&[]).stdout;
    assert!(told.contains("nothing is served yet: ") && told.contains("1 contributor has seen"), "{told}");

    let waiting =
        |service: &Service| http::get(&format!("{}/api/v1/map", service.http)).json()["waiting"].clone();
    let first = waiting(&service);
    assert!(
        first["tiles"].as_u64() > Some(2) && first["contributors"] == 1 && first["needed"] == 3,
        "{first}"
    );
    let status = command::echofix(["status", "--http", &service.http]).stdout;
    assert!(status.contains("nothing is served yet: ") && status.contains("3 are needed"), "{status}");

    let at = asking::requests(&street(&city, 20, "visitor"), 8.0, 1).remove(0).request;
    let prior = at.prior.and_then(|prior| prior.pose).expect("a question has a prior");
    let route = GetCoverageRequest {
        latitude_deg: vec![prior.latitude_deg, prior.latitude_deg + 0.5],
        longitude_deg: vec![prior.longitude_deg; 2],
        expectations: false,
    };
    let coverage = grpc::reading(&service).await.get_coverage(route.clone()).await.unwrap().into_inner();
    assert_eq!((coverage.cells, coverage.contributors), (vec![0, 0], vec![1, 0]));
    assert_eq!(coverage.contributors_needed, 3);

    service.kill();
    service.start_again();
    assert_eq!(waiting(&service), first, "after a restart");
    crowd(&service, &city, &["boris", "carla", "dora"]).await;
    folded(&service).await;
    let left = waiting(&service);
    assert!(left["tiles"].as_u64() < first["tiles"].as_u64(), "{left}");
    let coverage = grpc::reading(&service).await.get_coverage(route).await.unwrap().into_inner();
    assert!(coverage.cells[0] > 100 && coverage.contributors == [0, 0], "{coverage:?}");
}

/// The uploads kept out from an epoch on.
fn kept_out_after(service: &Service, epoch: u64) -> Vec<Value> {
    let report = quarantine(service);
    let uploads = report["uploads"].as_array().expect("uploads are a list").iter();
    uploads.filter(|upload| upload["epoch"].as_u64() > Some(epoch)).cloned().collect()
}

/// Catches: an upload that is folded and quarantined, an offset of the wrong sign or size, honest drivers kept out.
#[tokio::test(flavor = "multi_thread")]
async fn what_lies_beside_the_map_is_kept_out() {
    let city = the_town();
    let service = Service::start();
    crowd(&service, &city, &["anna", "boris"]).await;
    assert_eq!(quarantine(&service)["quarantined"], 0, "honest ones count");
    let before = tiles::all(&service).await;

    let epoch = folded(&service).await;
    let sent = contribute(&service, &shifted(street(&city, 5, "shifty"), 2.0, 0.0)).await.len();
    let kept_out = kept_out_after(&service, epoch);
    assert_eq!(kept_out.len(), sent, "{kept_out:#?}");
    for upload in &kept_out {
        assert_eq!(upload["reason"], "SHIFTED", "{upload}");
        let off = |axis: &str| upload["offset"][axis].as_f64().expect("an offset is known");
        // It says what would bring the upload home.
        assert!((off("east_m") + 2.0).hypot(off("north_m")) < 0.4, "{upload}");
    }
    assert!(tiles::all(&service).await == before, "not a byte changes");
    is_seen(&service, sent);

    let epoch = folded(&service).await;
    let sent = contribute(&service, &turned(street(&city, 6, "dizzy"), 3_f64.to_radians())).await.len();
    let kept_out = kept_out_after(&service, epoch);
    assert_eq!(kept_out.len(), sent, "{kept_out:#?}");
    let rotated = kept_out.iter().filter(|upload| upload["reason"] == "ROTATED").count();
    assert!(rotated > 0, "{kept_out:#?}");
    assert!(tiles::all(&service).await == before, "not a byte changes");

    let epoch = folded(&service).await;
    contribute(&service, &street(&city, 9, "carla")).await;
    assert_eq!(kept_out_after(&service, epoch), [Value::Null; 0], "an honest one of another day counts");
    assert!(tiles::all(&service).await != before);
}

/// Catches: an operator who looks where operators look, and sees nothing but "counted".
fn is_seen(service: &Service, kept_out: usize) {
    let ask = |path: &str| http::get(&format!("{}{path}", service.http));
    until_blocking("the feed says so", Duration::from_secs(10), || {
        let uploads = ask("/api/v1/uploads?limit=500").json();
        let uploads = uploads["uploads"].as_array().expect("uploads are a list").clone();
        let marked = uploads.iter().filter(|upload| upload["outcome"] == "QUARANTINED").count();
        let counted = http::metric(ask("/metrics").text(), "echofix_quarantined_total{outcome=\"SHIFTED\"}");
        let there = http::metric(ask("/metrics").text(), "echofix_in_quarantine");
        // Counts are whole numbers.
        (marked == kept_out && [counted, there].map(|count| count as usize) == [kept_out; 2]).then_some(())
    });
    assert!(service.log().contains("vetting kept an upload out of the map"));
    let run = command::echofix(["map", "quarantine", "--http", &service.http]);
    assert!(
        run.code == Some(0) && run.stdout.contains(&format!("{kept_out} uploads are in quarantine")),
        "{run:?}"
    );
    assert!(run.stdout.contains("shifted"), "{run:?}");
    let status = command::echofix(["status", "--http", &service.http]);
    assert!(status.stdout.contains("in quarantine") && !status.stdout.contains("ALARM"), "{status:?}");
    let history = command::echofix(["map", "history", "--http", &service.http]);
    assert!(history.stdout.contains(&format!("{kept_out} of them in quarantine")), "{history:?}");
    let alarms = command::echofix(["map", "alarms", "--http", &service.http]);
    assert!(alarms.stdout.contains("there is no alarm"), "{alarms:?}");
}

/// Catches: quarantined uploads that come to count once they are many.
#[tokio::test(flavor = "multi_thread")]
async fn three_who_agree_on_a_shift_raise_an_alarm_and_publish_nothing() {
    let city = the_town();
    let service = Service::start();
    crowd(&service, &city, &["anna", "boris"]).await;
    let before = tiles::all(&service).await;
    for (number, vehicle) in (0..).zip(["dora", "emil", "fritz"]) {
        assert_eq!(quarantine(&service)["alarms"], json!([]), "{number} contributors are too few");
        contribute(&service, &shifted(street(&city, 5 + number, vehicle), 0.0, 1.5)).await;
    }
    let report = quarantine(&service);
    let alarms = report["alarms"].as_array().expect("alarms are a list");
    assert!(!alarms.is_empty(), "{report:#}");
    for alarm in alarms {
        assert_eq!((&alarm["kind"], &alarm["contributors"]), (&json!("SHIFT"), &json!(3)), "{alarm}");
        let off = |axis: &str| alarm["offset"][axis].as_f64().expect("a shift has an offset");
        assert!(off("east_m").hypot(off("north_m") + 1.5) < 0.4, "{alarm}");
    }
    for words in [&["map", "alarms"][..], &["status"]] {
        let told = command::echofix(words.iter().copied().chain(["--http", &service.http])).stdout;
        assert!(told.contains("ALARM: 3 contributors agree at "), "{told}");
    }
    assert!(tiles::all(&service).await == before, "nothing is published by itself");
}

/// Waits until the map shows all that was decided; kills the service at any moments of the way there.
async fn decided(service: &mut Service, kills: u32, rng: &mut ChaCha8Rng) -> Tiles {
    for _ in 0..kills {
        tokio::time::sleep(Duration::from_millis(rng.random_range(0..200))).await;
        service.kill();
        service.launch_again();
    }
    service.wait_until_ready();
    folded(service).await;
    tiles::all(service).await
}

fn revoke(service: &Service, contributor: &str) -> Value {
    let body = json!({ "contributor": contributor });
    let answer = http::post(&format!("{}/api/v1/map/revoke", service.http), &body);
    assert_eq!(answer.status, 200, "{}", answer.text());
    answer.json()
}

fn building(service: &Service) -> bool {
    !http::get(&format!("{}/api/v1/map", service.http)).json()["building"].is_null()
}

/// Catches: a revocation that leaves a vote, a datum or a fading behind, one that is lost in a crash, and one that
/// is applied in part.
#[tokio::test(flavor = "multi_thread")]
async fn who_is_revoked_has_never_been_there() {
    let city = the_town();
    let mut rng = ChaCha8Rng::seed_from_u64(town::seed());
    let mut with = Service::start();
    let without = Service::start();
    // What comes after is vetted and moved by the map that the revoked one helped to make.
    for (day, vehicle) in (0..).zip(["anna", "mallory", "boris", "carla"]) {
        let drive = street(&city, day, vehicle);
        contribute(&with, &drive).await;
        if vehicle != "mallory" {
            contribute(&without, &drive).await;
        }
    }
    let never = tiles::all(&without).await;
    let before = tiles::all(&with).await;
    assert!(bytes(&before) != bytes(&never), "the one to be revoked has changed the map");

    revoke(&with, "mallory");
    until_blocking("it is being built", Duration::from_secs(20), || {
        let map = http::get(&format!("{}/api/v1/map", with.http)).json();
        (building(&with) || map["epoch"] == map["journaled"]).then_some(())
    });
    let killed = decided(&mut with, 5, &mut rng).await;
    assert!(bytes(&killed) == bytes(&never), "killed while it was built");
    with.kill();
    with.start_again();
    assert!(tiles::all(&with).await == killed, "as it was before the restart, to the version");

    // And undisturbed, another one.
    revoke(&with, "boris");
    revoke(&without, "boris");
    folded(&with).await;
    folded(&without).await;
    let (one, other) = (tiles::all(&with).await, tiles::all(&without).await);
    assert!(bytes(&one) == bytes(&other) && bytes(&one) != bytes(&killed));
}

/// Support blocks in which each of some drives has hits.
fn supported(drive: &Drive) -> BTreeSet<(TileId, usize)> {
    let of_upload = |upload: PreparedUpload| {
        let tiles = upload.evidence().expect("the recorder makes evidence").tiles.into_iter();
        let blocks = tiles
            .flat_map(|(id, evidence)| evidence.cells.into_iter().map(move |c| (id, support_block(c.index))));
        blocks.collect::<Vec<_>>()
    };
    uploads(drive).into_iter().flat_map(of_upload).collect()
}

/// Catches: support that is counted by hits, by uploads or by days.
///
/// What is served are blocks that three support; where two honest ones saw something anyway, clutter or a car,
/// a third may add to it: that is the limit of what counting can do, and how much it is, is printed.
#[tokio::test(flavor = "multi_thread")]
async fn a_wall_that_one_of_four_invents_is_not_served() {
    let city = the_town();
    let service = Service::start_with(&[THREE]);
    let honest = ["anna", "boris", "carla"];
    let drives: Vec<_> = (0..).zip(honest).map(|(day, vehicle)| street(&city, day, vehicle)).collect();
    for drive in &drives {
        contribute(&service, drive).await;
    }
    let before = cells(&tiles::all(&service).await);
    let mut support: BTreeMap<(TileId, usize), usize> = BTreeMap::new();
    for block in drives.iter().flat_map(supported) {
        *support.entry(block).or_default() += 1;
    }

    // Across the lane, at several positions: where all of them drove.
    let truth = asking::truth(&drives[0]);
    let grid = Grid::of(drives[0].truth[0].at).expect("the town is on the map");
    let first = drives[0].truth[0].time_us;
    let last = drives[0].truth.last().expect("it drove").time_us;
    let walls = (1..6).filter_map(|i| truth.at(first + (last - first) * i / 6)).flat_map(|pose| {
        let pose = grid.pose_from_geodetic(pose.at, pose.yaw_rad).expect("on the map");
        (-15..15).map(move |i| MapPoint::from(pose.transform([4.0, 0.1 * f64::from(i)])))
    });
    let wall = hits(grid.zone(), walls, 50);
    let phantom: BTreeSet<_> =
        wall.tiles.iter().flat_map(|(id, evidence)| evidence.cells.iter().map(|c| (*id, c.index))).collect();
    assert!(phantom.len() > 100);
    let mut client = grpc::mapping(&service).await;
    // On several days, and several times a day.
    for number in 0..12 {
        let time_us = first + (number % 4) * DAY_US;
        let id = Uuid::from_u64_pair(1, number as u64);
        send(&mut client, &upload(id, "mallory", time_us, &wall)).await.expect("a forger keeps to the form");
    }
    folded(&service).await;
    let after = cells(&tiles::all(&service).await);
    let shown = after.keys().filter(|cell| phantom.contains(cell) && !before.contains_key(cell));
    let honest_ones =
        |(id, index): &(TileId, u32)| support.get(&(*id, support_block(*index))).copied().unwrap_or(0);
    // Vetting moves what is honest by some centimetres, over a block's border, too.
    let mut by_honest = [0; 4];
    shown.for_each(|cell| by_honest[honest_ones(cell)] += 1);
    eprintln!(
        "{} phantom cells; served where 0, 1, 2, 3 honest ones saw something: {by_honest:?}",
        phantom.len()
    );
    assert_eq!(by_honest[..2], [0, 0], "of {} phantom cells", phantom.len());
    assert!(by_honest.iter().sum::<usize>() * 10 < phantom.len(), "a wall is to be seen");
}

/// A vehicle drives along the street on a day and uploads what is wanted; how much it did not make, and what it was answered.
async fn keeps_to(service: &Service, city: &City, day: u32, demand: &Arc<Demand>) -> (u64, usize) {
    let drive = street(city, day, "regular");
    let today = echofix_core::time::day_of(drive.reference[0].time_us);
    let recorded = record_wanted(&drive, to_the_ends(), Some(demand)).expect("the drive is sound");
    let mut client = grpc::mapping(service).await;
    for upload in &recorded.uploads {
        demand.learn(&send(&mut client, upload.parts()).await.expect("it is taken"), today);
    }
    folded(service).await;
    (recorded.not_wanted, recorded.uploads.len())
}

/// Catches: a vehicle that is never told that enough is known, one that goes on all the same, and one that never comes back.
#[tokio::test(flavor = "multi_thread")]
async fn a_street_that_is_known_well_is_uploaded_again_after_a_while() {
    let enough = ["mapping.publish_contributors=1", "mapping.enough_passes=2", "mapping.refresh_days=14"];
    let (service, city) = (Service::start_with(&enough), the_town());
    let folder = tempfile::tempdir().expect("a folder can be made");
    let open = || Arc::new(Demand::open(&folder.path().join("demand"), "regular").expect("it can be opened"));
    let demand = open();
    let (not_wanted, sent) = keeps_to(&service, &city, 0, &demand).await;
    assert!(not_wanted == 0 && sent > 0, "{sent} sent, {not_wanted} not wanted");
    let mut known = 1;
    while keeps_to(&service, &city, known, &demand).await.1 > 0 {
        known += 1;
        assert!(known < 9, "it is never known well");
    }
    demand.save().expect("it can be written");
    let demand = open();
    let (not_wanted, sent) = keeps_to(&service, &city, known, &demand).await;
    assert!(not_wanted > 0 && sent == 0, "{sent} sent, {not_wanted} not wanted");
    let way: Vec<_> =
        street(&city, known, "regular").reference.iter().step_by(10).map(|pose| pose.at).collect();
    let request = GetCoverageRequest {
        latitude_deg: way.iter().map(|at| at.lat_deg).chain([0.0]).collect(),
        longitude_deg: way.iter().map(|at| at.lon_deg).chain([0.0]).collect(),
        expectations: false,
    };
    let mut reading = grpc::reading(&service).await;
    let coverage = reading.get_coverage(request).await.expect("it is answered").into_inner();
    let wanted = &coverage.wanted_from_day;
    let newest = coverage.newest_day.iter().max().expect("there are points");
    assert_eq!(wanted.last(), Some(&0), "nothing is known there");
    assert!(wanted.iter().any(|day| (newest + 1..=newest + 14).contains(day)), "{coverage:?}");
    for at in &way {
        demand.surprise(*at);
    }
    assert!(keeps_to(&service, &city, known, &demand).await.1 > 0, "the map seemed to have changed");
    let (_, sent) = keeps_to(&service, &city, 60, &demand).await;
    assert!(sent > 0, "it is long ago");
}
