//! The operators' port: probes, metrics, map layers, catalog, feeds; and no vehicle's name anywhere.

use std::fs;
use std::path::Path;
use std::time::Duration;

use echofix_core::geo::LatLon;
use echofix_proto::v1::FixStatus;
use echofix_tests::http::{Answer, Events, get, get_with, metric};
use echofix_tests::service::Service;
use echofix_tests::world::World;
use echofix_tests::{grpc, mapping, until_blocking};
use tokio::sync::OnceCell;

/// A mapped town on a service that logs all there is to log.
async fn world() -> &'static World {
    static WORLD: OnceCell<World> = OnceCell::const_new();
    WORLD.get_or_init(|| World::mapped_with(Service::start_with(&["log.filter=trace"]))).await
}

/// `GET` a path of the mapped town's service.
fn ask(world: &World, path: &str) -> Answer {
    get(&format!("{}{path}", world.service.http))
}

/// Catches probes that tell nothing, and a page or a description that is not there.
#[tokio::test(flavor = "multi_thread")]
async fn the_probes_the_console_and_the_description_are_there() {
    let world = world().await;
    assert_eq!(ask(world, "/healthz").json()["alive"], true);
    let ready = ask(world, "/readyz");
    assert_eq!((ready.status, &ready.json()["ready"]), (200, &true.into()));
    let page = ask(world, "/");
    assert!(page.header("content-type").unwrap().starts_with("text/html") && page.text().contains("<html"));
    let description = ask(world, "/openapi.json").json();
    assert!(description["openapi"].as_str().unwrap().starts_with("3."));
    for path in ["/api/v1/map", "/api/v1/fixes", "/metrics", "/tiles/{layer}/{z}/{x}/{y}.png"] {
        assert!(description["paths"][path]["get"].is_object(), "{path} is described");
    }
    let nothing = ask(world, "/nothing");
    assert_eq!((nothing.status, &nothing.json()["error"]["code"]), (404, &"not_found".into()));
}

/// The tile of web maps that holds a position (Slippy map tilenames).
fn web_tile(at: LatLon, zoom: u32) -> String {
    let n = f64::from(1_u32 << zoom);
    let lat = at.lat_deg.to_radians();
    let x = (at.lon_deg + 180.0) / 360.0 * n;
    let y = (1.0 - (lat.tan() + 1.0 / lat.cos()).ln() / std::f64::consts::PI) / 2.0 * n;
    format!("{zoom}/{}/{}.png", x as u32, y as u32)
}

/// Catches a layer that shows nothing of a mapped road, calls a town's road useless, or is not the one that the
/// numbers tell.
#[tokio::test(flavor = "multi_thread")]
async fn what_fixes_can_be_expected_to_be_is_drawn_and_told() {
    let world = world().await;
    let at = world.visit(200.0).truth[0].at;
    let path = format!("/tiles/localizability/{}", web_tile(at, 18));
    let picture = ask(world, &path);
    assert_eq!((picture.status, picture.header("content-type")), (200, Some("image/png")));
    let far = LatLon { lat_deg: at.lat_deg + 1.0, ..at };
    let empty = ask(world, &format!("/tiles/localizability/{}", web_tile(far, 18)));
    assert!(empty.status == 200 && empty.body != picture.body);

    let tile = ask(world, &format!("/api/v1/tiles/at?lat={}&lon={}", at.lat_deg, at.lon_deg)).json();
    let report = ask(world, &format!("/api/v1/tiles/{}/localizability", tile["id"].as_str().unwrap())).json();
    assert!(report["version"].as_u64() >= tile["version"].as_u64(), "{report}");
    let spots = report["places"].as_array().unwrap();
    let nearest = |spot: &&serde_json::Value| {
        let off = |key: &str, there: f64| spot[key].as_f64().unwrap() - there;
        let east = off("longitude_deg", at.lon_deg) * at.lat_deg.to_radians().cos();
        (1e9 * off("latitude_deg", at.lat_deg).hypot(east)) as u64
    };
    let here = spots.iter().min_by_key(nearest).unwrap();
    assert_eq!(here["expected"], "USABLE", "{report}");
    let sigma_m = here["weakest_sigma_m"].as_f64().unwrap();
    assert!((0.05..0.4).contains(&sigma_m), "{report}");
}

/// Catches layers that are empty, at the wrong position, or drawn again although nothing has changed.
#[tokio::test(flavor = "multi_thread")]
async fn map_layers_are_pictures_that_are_sent_once() {
    let world = world().await;
    let at = world.visit(200.0).truth[0].at;
    for layer in ["evidence", "coverage", "age"] {
        for zoom in [14, 18] {
            let path = format!("/tiles/{layer}/{}", web_tile(at, zoom));
            let picture = ask(world, &path);
            assert_eq!((picture.status, picture.header("content-type")), (200, Some("image/png")), "{path}");
            assert!(picture.body.starts_with(b"\x89PNG\r\n\x1a\n"), "{path}");
            let tag = picture.header("etag").expect("a picture has a tag").to_owned();
            let again = get_with(&format!("{}{path}", world.service.http), &[("if-none-match", &tag)]);
            assert_eq!((again.status, again.body.len()), (304, 0), "{path}");
            let far = LatLon { lat_deg: at.lat_deg + 1.0, ..at };
            let empty = ask(world, &format!("/tiles/{layer}/{}", web_tile(far, zoom)));
            assert!(empty.status == 200 && empty.body != picture.body, "{path} shows something");
        }
        let description = ask(world, &format!("/tiles/{layer}.json")).json();
        assert_eq!(description["tilejson"], "3.0.0");
        let bounds: Vec<f64> =
            description["bounds"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert!(
            bounds[0] < at.lon_deg
                && at.lon_deg < bounds[2]
                && bounds[1] < at.lat_deg
                && at.lat_deg < bounds[3]
        );
        let template = description["tiles"][0].as_str().unwrap();
        let named = template.replace("{z}/{x}/{y}.png", &web_tile(at, 18));
        assert_eq!(get(&named).status, 200, "{named} is what the description says");
    }
}

/// Catches a catalog that disagrees with what was uploaded.
#[tokio::test(flavor = "multi_thread")]
async fn the_catalog_counts_what_the_uploads_were_told() {
    let world = world().await;
    let map = ask(world, "/api/v1/map").json();
    let epoch = world.answers.iter().map(|a| a.epoch).max().unwrap();
    assert_eq!(
        (&map["state"], &map["epoch"], &map["journaled"]),
        (&"serving".into(), &epoch.into(), &epoch.into())
    );
    assert_eq!(map["totals"]["uploads"], world.answers.len());
    assert_eq!(map["totals"]["newest_date"], "2026-01-01");
    assert_eq!(
        (&map["zones"][0]["epsg"], &map["zones"][0]["tiles"]),
        (&32614.into(), &map["totals"]["tiles"])
    );
    let at = world.visit(200.0).truth[0].at;
    let tile = ask(world, &format!("/api/v1/tiles/at?lat={}&lon={}", at.lat_deg, at.lon_deg)).json();
    assert!(tile["cells"].as_u64().unwrap() > 1_000 && tile["epsg"] == 32614, "{tile}");
    let same = ask(world, &format!("/api/v1/tiles/{}", tile["id"].as_str().unwrap())).json();
    assert_eq!(same, tile);
    // Both mappers drove there: some cells were confirmed.
    assert!(tile["passes"].as_array().unwrap().iter().any(|row| row["passes"] == 2), "{tile}");
    assert_eq!(ask(world, "/api/v1/tiles/at?lat=95&lon=0").status, 400);
    assert_eq!(ask(world, "/api/v1/fixes?limit=0").status, 400);
}

/// Catches a fix or an upload that is not counted, not fed to the operators, or counted twice.
#[tokio::test(flavor = "multi_thread")]
async fn a_fix_and_an_upload_are_counted_and_told_at_once() {
    let seed = echofix_tests::town::seed();
    let city = echofix_tests::town::town(seed);
    let service = Service::start();
    let mut uploads = mapping::uploads(&echofix_tests::town::survey(&city, 0, "mapper", seed));
    let last = uploads.pop().unwrap();
    let (mut sender, mut client) = (grpc::mapping(&service).await, grpc::localizing(&service).await);
    for upload in &uploads {
        mapping::send(&mut sender, upload.parts()).await.expect("the upload counts");
    }
    mapping::folded(&service).await;
    let url = service.http.clone();
    let metrics = || get(&format!("{url}/metrics"));
    let kind = metrics().header("content-type").unwrap().to_owned();
    assert!(
        kind.starts_with("application/openmetrics-text") && metrics().text().ends_with("# EOF\n"),
        "{kind}"
    );
    let before = metrics().text().to_owned();

    let mut events = Events::listen(&format!("{url}/api/v1/events"), Duration::from_secs(20));
    // The state of the map comes first: from here on nothing is missed.
    assert_eq!(events.next("map")["epoch"], uploads.len());
    let answer = mapping::send(&mut sender, last.parts()).await.expect("the upload counts");
    let report = events.next("upload");
    assert_eq!((&report["upload_id"], &report["outcome"]), (&answer.upload_id.into(), &"COUNTED".into()));
    assert_eq!(report["detections_counted"], answer.detections_counted);
    mapping::folded(&service).await;

    let visit = echofix_tests::town::wander(&city, 3, "visitor", seed, 150.0);
    let case = echofix_tests::asking::requests(&visit, 1.0, seed).remove(3);
    let answer = client.localize(case.request.clone()).await.expect("there is a map").into_inner();
    let report = events.next("fix");
    let word = answer.status().as_str_name().trim_start_matches("FIX_STATUS_").to_owned();
    let pose = answer.pose.unwrap();
    assert_eq!(
        (&report["status"], &report["latitude_deg"]),
        (&word.clone().into(), &pose.latitude_deg.into())
    );
    assert_eq!(report["protection_m"].is_number(), answer.status() == FixStatus::Usable);
    assert_eq!(get(&format!("{url}/api/v1/fixes")).json()["fixes"], serde_json::json!([report]));
    let fed = get(&format!("{url}/api/v1/uploads?limit=500")).json();
    assert_eq!(fed["uploads"].as_array().unwrap().len(), uploads.len() + 1);

    let mut malformed = case.request.clone();
    malformed.prior = None;
    client.localize(malformed).await.expect_err("it is refused");
    let after = metrics().text().to_owned();
    let moved = |name: &str| metric(&after, name) - metric(&before, name);
    for (name, by) in [
        (format!("echofix_fixes_total{{outcome=\"{word}\"}}"), 1.0),
        ("echofix_fixes_total{outcome=\"INVALID_ARGUMENT\"}".to_owned(), 1.0),
        ("echofix_uploads_total{outcome=\"COUNTED\"}".to_owned(), 1.0),
        ("echofix_align_seconds_count".to_owned(), 1.0),
        ("echofix_map_epoch".to_owned(), 1.0),
    ] {
        assert!((moved(&name) - by).abs() < 1e-9, "{name} moved by {}:\n{after}", moved(&name));
    }
}

/// Catches a name that leaves a trace: in the log at its most talkative, the metrics, the feeds, the
/// catalog, or a file of the data directory.
#[tokio::test(flavor = "multi_thread")]
async fn no_contributor_is_named_anywhere() {
    let world = world().await;
    let mut client = grpc::mapping(&world.service).await;
    // Refusals are where names slip into words.
    for upload in mapping::uploads(&world.visit(150.0)) {
        let mut parts = upload.parts().to_vec();
        parts.truncate(1);
        mapping::send(&mut client, &parts).await.expect_err("an upload without chunks is refused");
    }
    let mut said = vec![("log".to_owned(), world.service.log().into_bytes())];
    for path in ["/metrics", "/api/v1/uploads?limit=500", "/api/v1/fixes", "/api/v1/map"] {
        said.push((path.to_owned(), ask(world, path).body));
    }
    assert!(said[0].1.len() > 1_000, "at its most talkative the log says something");
    files(&world.service.data_dir(), &mut said);
    assert!(said.iter().any(|(name, bytes)| name.contains("journal") && bytes.len() > 10_000));
    for (source, bytes) in &said {
        for name in World::MAPPERS.into_iter().chain(["visitor"]) {
            let found = bytes.windows(name.len()).any(|window| window == name.as_bytes());
            assert!(!found, "`{name}` is in {source}");
        }
    }
}

/// All files below a folder.
fn files(folder: &Path, found: &mut Vec<(String, Vec<u8>)>) {
    for entry in fs::read_dir(folder).expect("the folder is there") {
        let path = entry.expect("the folder can be read").path();
        if path.is_dir() {
            files(&path, found);
        } else {
            found.push((path.display().to_string(), fs::read(&path).expect("the file can be read")));
        }
    }
}

/// Catches a fast engine that nobody watches: breaks when answers are not asked again, or not counted.
#[tokio::test(flavor = "multi_thread")]
async fn answers_are_confirmed_by_the_exhaustive_engine_and_counted() {
    let world = World::mapped_with(Service::start_with(&["locating.confirm_share=1"])).await;
    let mut client = grpc::localizing(&world.service).await;
    let asked = world.questions(120.0, 3.0);
    for case in &asked {
        let answer = client.localize(case.request.clone()).await.expect("the question is answered");
        assert_eq!(answer.into_inner().status(), FixStatus::Usable);
    }
    // It takes its time, after the answer.
    let counted = until_blocking("all answers are confirmed", Duration::from_mins(2), || {
        let metrics = ask(&world, "/metrics");
        let [agree, differ] = ["agree", "differ"].map(|outcome| {
            metric(metrics.text(), &format!("echofix_confirmations_total{{outcome=\"{outcome}\"}}"))
        });
        (agree + differ >= asked.len() as f64).then_some([agree, differ])
    });
    assert!(
        asked.len() >= 3 && counted.map(|n| n as usize) == [asked.len(), 0],
        "{counted:?} of {}",
        asked.len()
    );
}
