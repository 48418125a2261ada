//! Places on earth where longitudes jump: bounds, descriptions, pictures, copies and exports of a map are right at the date line, too.

use echofix_core::geo::LatLon;
use echofix_sim::Route;
use echofix_tests::command::{CommandRun, echofix};
use echofix_tests::mapping::contribute;
use echofix_tests::service::Service;
use echofix_tests::{http, town};
use serde_json::Value;

const fn at(lat_deg: f64, lon_deg: f64) -> LatLon {
    LatLon { lat_deg, lon_deg }
}

/// The third and the fourth lie on the date line itself, on either hemisphere.
const PLACES: [(&str, LatLon); 7] = [
    ("Tonga", at(-21.139, -175.204)),
    ("Adak", at(51.88, -176.658)),
    ("Taveuni", at(-16.83, 180.0)),
    ("Chukotka", at(66.35, -180.0)),
    ("Apia", at(-13.83, -171.76)),
    ("Suva", at(-18.141, 178.442)),
    ("Munich", at(48.137, 11.575)),
];

/// How far it is eastwards from one longitude to another, degrees.
fn eastwards(from: f64, to: f64) -> f64 {
    (to - from).rem_euclid(360.0)
}

/// The longitude, -180 to 180 degrees.
fn wrapped(lon_deg: f64) -> f64 {
    (lon_deg + 180.0).rem_euclid(360.0) - 180.0
}

fn degrees(of: &Value) -> Vec<f64> {
    of.as_array().expect("a list").iter().map(|degrees| degrees.as_f64().expect("degrees")).collect()
}

/// A box some kilometres wide around a place, as the command takes it.
fn around(place: LatLon) -> String {
    let (west, east) = (wrapped(place.lon_deg - 0.1), wrapped(place.lon_deg + 0.1));
    format!("{west},{},{east},{}", place.lat_deg - 0.01, place.lat_deg + 0.01)
}

/// The bounds are as narrow as the town, and their middle is in it.
fn bounds_are_right(name: &str, place: LatLon, map: &Value) {
    let (bounds, center) = (degrees(&map["bounds"]), degrees(&map["center"]));
    let [west, south, east, north] = bounds[..] else { panic!("{name}: {map}") };
    assert!(eastwards(west, east) < 0.1 && north - south < 0.1, "{name}: {bounds:?}");
    let off = eastwards(center[0] + 180.0, place.lon_deg) - 180.0;
    assert!(off.abs() < 0.05 && (center[1] - place.lat_deg).abs() < 0.02, "{name}: {center:?}");
}

/// The description's bounds are in order and hold its centre, and a picture of the centre shows something.
fn description_is_right(name: &str, service: &Service) {
    let description = http::get(&format!("{}/tiles/evidence.json", service.http)).json();
    let (bounds, center) = (degrees(&description["bounds"]), degrees(&description["center"]));
    assert!(
        bounds[0] < bounds[2] && (-180.0..=180.0).contains(&bounds[0]) && bounds[2] <= 180.0,
        "{name}: {bounds:?}"
    );
    let held = eastwards(bounds[0], center[0]) <= bounds[2] - bounds[0] + 1e-9;
    assert!(held && (bounds[1]..=bounds[3]).contains(&center[1]), "{name}: {description}");
    let n = f64::from(1_u32 << 14);
    let lat = center[1].to_radians();
    let x = ((wrapped(center[0]) + 180.0) / 360.0 * n) as u32;
    let y = ((1.0 - (lat.tan() + 1.0 / lat.cos()).ln() / std::f64::consts::PI) / 2.0 * n) as u32;
    let drawn = |x: u32| {
        let picture = http::get(&format!("{}/tiles/evidence/14/{x}/{y}.png", service.http));
        assert_eq!(picture.status, 200, "{name}");
        picture.body.len()
    };
    let (left, nothing) = ((x + (1 << 14) - 1) % (1 << 14), drawn((x + (1 << 13)) % (1 << 14)));
    assert!(drawn(x).max(drawn(left)) > nothing + 50, "{name}: nothing is drawn");
}

fn done(name: &str, run: &CommandRun) -> Value {
    assert_eq!(run.code, Some(0), "{name}: {run:#?}");
    run.json()
}

/// All ways to ask for all tiles give all.
fn copies_are_whole(name: &str, place: LatLon, service: &Service, tiles: u64) {
    let scratch = service.scratch();
    let path = |file: &str| scratch.join(file).to_str().expect("the path is Unicode").to_owned();
    let areas = [None, Some("-180,-90,180,90".to_owned()), Some(around(place))];
    for (number, area) in areas.into_iter().enumerate() {
        let (copy, file) = (path(&format!("tiles-{number}")), path(&format!("{number}.efx")));
        let mut sync = vec!["tiles", "sync", &copy, "--server", &service.grpc, "--json"];
        let mut export = vec!["map", "export", &file, "--http", &service.http, "--json"];
        if let Some(area) = &area {
            sync.extend(["--area", area]);
            export.extend(["--box", area]);
        }
        assert_eq!(done(name, &echofix(&sync))["fetched"], tiles, "{name}: {area:?}");
        done(name, &echofix(&export));
        let known = done(name, &echofix(["map", "import", &file, "--http", &service.http, "--json"]));
        assert_eq!((&known["tiles"], &known["known"]), (&tiles.into(), &tiles.into()), "{name}: {area:?}");
    }
}

/// Catches: a map whose bounds go once around the world, whose middle is on its other side, whose tiles nobody is sent who asks for
/// all or for a box across the date line, and a picture that is empty there.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_whole_at_every_place_on_earth() {
    for (name, place) in PLACES {
        let service = Service::start();
        let city = town::town_at(town::seed(), place);
        let drive = town::drive(&city, 0, "mapper", 1, &Route::wander(&city, 1, 120.0));
        contribute(&service, &drive).await;
        let map = http::get(&format!("{}/api/v1/map", service.http)).json();
        let tiles = map["totals"]["tiles"].as_u64().expect("a count");
        assert!(tiles > 0, "{name}: {map}");
        bounds_are_right(name, place, &map);
        description_is_right(name, &service);
        copies_are_whole(name, place, &service, tiles);
    }
}
