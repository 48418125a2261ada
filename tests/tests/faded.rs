//! A map fades with its newest day: what is served, localized against and drawn is the same, at once and after a restart.

use echofix_core::geo::LatLon;
use echofix_tests::mapping::contribute;
use echofix_tests::service::Service;
use echofix_tests::{asking, crowd, grpc, http, tiles, town};

/// What the map shows of the street: the size of its picture, whether one who knows an earlier one is sent it, cells that vehicles are
/// served, and what a question comes to.
async fn seen(service: &Service, at: LatLon, known: Option<&str>) -> (String, usize, u16, usize, String) {
    let n = f64::from(1_u32 << 16);
    let lat = at.lat_deg.to_radians();
    let x = ((at.lon_deg + 180.0) / 360.0 * n) as u32;
    let y = ((1.0 - (lat.tan() + 1.0 / lat.cos()).ln() / std::f64::consts::PI) / 2.0 * n) as u32;
    let url = format!("{}/tiles/evidence/16/{x}/{y}.png", service.http);
    let picture = http::get(&url);
    let again = known.map_or(200, |tag| http::get_with(&url, &[("if-none-match", tag)]).status);
    let here: Vec<_> =
        tiles::all(service).await.into_iter().filter(|(id, _)| id.zone.epsg() == 32_614).collect();
    let cells = crowd::cells(&here.into_iter().collect()).len();
    let city = town::town(town::seed());
    let question = asking::requests(&crowd::street(&city, 40, "visitor"), 8.0, 5).remove(0).request;
    let outcome = match grpc::localizing(service).await.localize(question).await {
        Ok(fix) => format!("{:?}", fix.into_inner().status()),
        Err(status) => grpc::reason(&status),
    };
    (picture.header("etag").expect("a tag").to_owned(), picture.body.len(), again, cells, outcome)
}

/// Catches: a picture, a tile, a prepared window or a browser's copy that stays as it was when a vehicle elsewhere brings a newer day,
/// and a restart that changes what is seen.
#[tokio::test(flavor = "multi_thread")]
async fn a_street_fades_everywhere_at_once() {
    let mut service = Service::start_with(&["mapping.expire_days=30", "mapping.retention_days=36500"]);
    let city = town::town(town::seed());
    let street = crowd::street(&city, 0, "anna");
    let at = street.truth[street.truth.len() / 2].at;
    contribute(&service, &street).await;
    let (tag, bytes, _, cells, outcome) = seen(&service, at, None).await;
    assert!(bytes > 1_000 && cells > 1_000 && outcome != "NO_MAP", "{bytes} {cells} {outcome}");

    // Somebody in another town, on a later day: nothing of the street changes but that it is old.
    let munich = town::town_at(town::seed(), LatLon { lat_deg: 48.137, lon_deg: 11.575 });
    contribute(&service, &crowd::street(&munich, 40, "boris")).await;
    let faded = seen(&service, at, Some(&tag)).await;
    assert_eq!((faded.2, faded.3), (200, 0), "{faded:?}");
    assert_ne!(faded.4, "Usable", "{faded:?}");
    assert!(faded.1 < bytes / 2 && faded.0 != tag, "{faded:?}, before {bytes} bytes");
    service.kill();
    service.start_again();
    assert_eq!(seen(&service, at, Some(&tag)).await, faded, "a restart changes nothing");
}
