//! HTTP for operators: map layers, the catalog, the feeds, health, metrics and the console.
//!
//! - `answers`: what is answered in JSON, as types.
//! - `access`: who asks, and whether they may.
//! - `session`: browsers sign in and out; `sign_in`: at an issuer.
//! - `error`: why a request was not answered, said once.
//! - `outside`: how callers address the port, with proxies in front.
//! - `cors`: which pages of other origins may ask it.
//! - `hosts`: which names the port answers to.
//! - `origin`: which pages may change anything.
//! - `limits`: what one request or many may cost.
//! - `probes`: alive, ready, counted.
//! - `catalog`: the map in numbers, one tile in numbers.
//! - `cells`: a tile to the cell, and why each is served or not.
//! - `expectation`: what fixes in a tile can be expected to be.
//! - `past`: the map as it was at an epoch.
//! - `operations`: the map's history, and whether what is stored is sound.
//! - `decisions`: what operators decide about it.
//! - `quarantine`: what vetting kept out, and alarms.
//! - `contributors`: who contributed, and what.
//! - `files`: regions out and in, backups.
//! - `region_days`: no region from the future comes in.
//! - `live`: the last fixes and uploads, and the stream of new ones.
//! - `meridians`: intervals of longitudes.
//! - `layers`: map tiles and their `TileJSON`.
//! - `raster`: how a map tile is drawn.
//! - `openapi`: the description of all this.
//! - `console`: the page an operator looks at.
//! - `base_map`: the map of streets below its radar map, where one is configured.

mod access;
mod answers;
mod base_map;
mod catalog;
mod cells;
mod console;
#[cfg(test)]
mod contract;
mod contributor;
mod contributors;
mod cors;
mod day;
mod decisions;
mod error;
mod expectation;
mod files;
mod hosts;
mod layers;
mod limits;
mod live;
mod meridians;
mod openapi;
mod operations;
mod origin;
mod outside;
mod past;
mod probes;
mod quarantine;
mod raster;
mod region_days;
mod session;
mod sign_in;
#[cfg(test)]
pub(crate) mod testing;

use std::path::PathBuf;
use std::sync::Arc;

use axum::Router;
use axum::http::HeaderValue;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::{MethodRouter, get, post};
use echofix_core::vetting::alarm::AlarmLimits;
use tokio::sync::watch;
use tower::Layer;
use tower::util::MapRequestLayer;

use crate::access_log::AccessLogLayer;
use crate::feed::Feed;
use crate::health::Health;
use crate::identity::{Gate, Rates, RatesConfig};
use crate::locating::Expectations;
use crate::metrics::Metrics;
use crate::port::Port;
use crate::store::{MapStore, Operations};
use crate::trace::RequestSpanLayer;
pub use base_map::{BaseMap, is_base_map};
pub use cors::{Origins, is_origin};
use error::Error;
pub use files::LAST_BACKUP;
pub use hosts::Hosts;
pub use outside::is_base_path;
pub use quarantine::{alarm_message, quarantine_event};

/// What the routes answer from.
#[derive(Clone)]
pub struct HttpState {
    /// The map that is served.
    pub store: Arc<dyn MapStore>,
    /// What fixes can be expected to be.
    pub expectations: Arc<Expectations>,
    /// What operators may do with it.
    pub operations: Arc<dyn Operations>,
    /// When quarantined uploads make an alarm.
    pub alarm_limits: AlarmLimits,
    /// The last fixes and uploads.
    pub feed: Arc<Feed>,
    /// What the service counts.
    pub metrics: Arc<Metrics>,
    /// Whether the service is ready.
    pub health: Arc<Health>,
    /// Where files are kept while they are received.
    pub spool_dir: PathBuf,
    /// The part of what is bounded that one peer may have.
    pub address_share: f64,
    /// Turns true when the service drains: answers without an end must end then.
    pub ending: watch::Receiver<bool>,
}

/// Where the port is found, and by whose pages.
#[derive(Debug, Clone)]
pub struct Place {
    /// The names that it answers to.
    pub hosts: Hosts,
    /// The path under which proxies show it: empty, or without a slash at its end.
    pub base_path: String,
    /// Other origins whose pages may ask it.
    pub origins: Origins,
    /// The map of streets that its console shows.
    pub base_map: Option<BaseMap>,
}

impl Place {
    /// Whatever name, at the root, for pages of its own.
    #[must_use]
    pub fn any() -> Self {
        Self { hosts: Hosts::any(), base_path: String::new(), origins: Origins::default(), base_map: None }
    }
}

/// The state of the routes: what they answer from, what they keep, what they may use.
struct App {
    state: HttpState,
    artist: Arc<raster::Artist>,
    past: past::PastMaps,
    limiter: limits::Limiter,
    gate: Arc<Gate>,
    rates: Arc<Rates>,
    base_map: Option<BaseMap>,
    /// What the console's page may load, and from where.
    page_policy: HeaderValue,
}

/// The routes, whatever name they are asked for by, and by whomever.
pub fn router(state: HttpState) -> Router {
    router_at(state, Place::any(), (Arc::new(Gate::open()), Arc::new(Rates::of(&RatesConfig::default()))))
}

/// The routes of a port, ready to be served.
pub fn router_at(state: HttpState, place: Place, (gate, rates): (Arc<Gate>, Arc<Rates>)) -> Router {
    let artist = raster::Artist::new(Arc::clone(&state.store), Arc::clone(&state.expectations));
    let artist = Arc::new(artist);
    let (past, limiter) =
        (past::PastMaps::new(state.address_share), limits::Limiter::of_port(state.address_share));
    let base_map = place.base_map.clone();
    let page_policy = console::policy(base_map.as_ref());
    let app = Arc::new(App { state, artist, past, limiter, gate, rates, base_map, page_policy });
    let (cors, base_path) = (place.origins.layer(), place.base_path.clone());
    let routes = routes()
        .into_iter()
        .fold(Router::new(), |router, (path, handler)| router.route(path, handler))
        .fallback(async || Error::NotFound("nothing is served here; see /openapi.json".to_owned()))
        .method_not_allowed_fallback(async || Error::MethodNotAllowed)
        .layer(from_fn_with_state(Arc::clone(&app), access::guard))
        .layer(from_fn_with_state(Arc::new(place), origin::guard))
        .layer(from_fn(limits::guard))
        .layer(from_fn_with_state(Arc::clone(&app), probes::counted));
    // Before anybody is asked who asks: a browser's question whether a page may ask carries nothing that says so.
    let routes = if let Some(cors) = cors { routes.layer(cors) } else { routes };
    let routes = routes.layer(RequestSpanLayer::http()).layer(AccessLogLayer(Port::Http)).with_state(app);
    if base_path.is_empty() {
        return routes;
    }
    // Around the routes, which are chosen by the path that is left.
    let mounted = MapRequestLayer::new(move |request| outside::unmounted(&base_path, request)).layer(routes);
    Router::new().fallback_service(mounted)
}

/// The paths of all routes, parameters in braces. Those that change the map answer POST, the others GET
/// and HEAD.
#[must_use]
pub fn paths() -> Vec<&'static str> {
    routes().into_iter().map(|(path, _)| path).collect()
}

fn routes() -> Vec<(&'static str, MethodRouter<Arc<App>>)> {
    vec![
        ("/healthz", get(probes::healthz)),
        ("/readyz", get(probes::readyz)),
        ("/metrics", get(probes::metrics)),
        ("/tiles/{layer}", get(layers::tilejson)),
        ("/tiles/{layer}/{z}/{x}/{y}", get(layers::tile)),
        ("/api/v1/map", get(catalog::map)),
        ("/api/v1/map/history", get(operations::history)),
        ("/api/v1/map/quarantine", get(quarantine::quarantine)),
        ("/api/v1/map/diff", get(operations::diff)),
        ("/api/v1/map/rollback", post(decisions::rollback)),
        ("/api/v1/map/revoke", post(decisions::revoke)),
        ("/api/v1/map/undo", post(decisions::undo)),
        ("/api/v1/map/compact", post(decisions::compact)),
        // Its former name, which older commands use.
        ("/api/v1/map/settle", post(decisions::settle)),
        ("/api/v1/map/verify", get(operations::verify).post(operations::verify_with_replay)),
        ("/api/v1/map/export", get(files::export)),
        ("/api/v1/map/import", post(files::import)),
        ("/api/v1/map/backup", get(files::backup)),
        ("/api/v1/tiles/at", get(catalog::tile_at)),
        ("/api/v1/tiles/{epsg}/{x}/{y}", get(catalog::tile)),
        ("/api/v1/tiles/{epsg}/{x}/{y}/localizability", get(expectation::tile)),
        ("/api/v1/tiles/{epsg}/{x}/{y}/cells", get(cells::cells)),
        ("/api/v1/cells/at", get(cells::cell_at)),
        ("/api/v1/contributors", get(contributors::contributors)),
        ("/api/v1/contributors/{hash}/uploads", get(contributors::uploads)),
        ("/api/v1/uploads/{id}", get(contributors::upload)),
        ("/api/v1/fixes", get(live::fixes)),
        ("/api/v1/uploads", get(live::uploads)),
        ("/api/v1/events", get(live::events)),
        ("/session", get(session::who).post(session::sign_in).delete(session::sign_out)),
        ("/session/ways", get(sign_in::ways)),
        ("/session/oidc", get(sign_in::begin)),
        ("/session/callback", get(sign_in::finish)),
        ("/openapi.json", get(openapi::document)),
        ("/", get(console::page)),
        ("/assets/{name}", get(console::asset)),
        ("/base-map", get(base_map::described)),
        ("/base-map.pmtiles", get(base_map::file)),
    ]
}

#[cfg(test)]
mod tests {
    use super::testing::{TestSite, json_of};
    use axum::http::Method;

    #[tokio::test]
    async fn what_is_not_served_says_so_in_json() {
        let site = TestSite::default();
        let response = site.get("/nowhere").await;
        assert_eq!(response.status(), 404);
        assert_eq!(json_of(response).await["error"]["code"], "not_found");
        let response = site.send(Method::POST, "/healthz", &[]).await;
        assert_eq!(response.status(), 405);
        let response = site.get(&format!("/api/v1/map?{}", "x".repeat(2000))).await;
        assert_eq!(response.status(), 414);
    }

    /// Catches: a request whose answer does not name it, or names it by whatever the caller chose.
    #[tokio::test]
    async fn every_answer_names_its_request() {
        let site = TestSite::default();
        for path in ["/healthz", "/nowhere", "/api/v1/tiles/at?lat=30&lon=-97"] {
            let given = site.send(Method::GET, path, &[("x-request-id", "op-7")]).await;
            assert_eq!(given.headers()["x-request-id"], "op-7", "{path}");
            let replaced = site.send(Method::GET, path, &[("x-request-id", "op 7")]).await;
            assert!(replaced.headers()["x-request-id"].len() == 36, "{path}");
        }
    }

    #[tokio::test]
    async fn every_answer_forbids_guessing_its_type() {
        let site = TestSite::default();
        for path in ["/healthz", "/", "/nowhere", "/tiles/evidence/0/0/0.png"] {
            assert_eq!(site.get(path).await.headers()["x-content-type-options"], "nosniff", "{path}");
        }
    }
}
