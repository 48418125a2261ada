//! Alive, ready, counted.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::App;
use super::answers::{AliveAnswer, PartReadiness, ReadinessAnswer, ReadyAnswer};
use crate::health::{Readiness, ServiceReadiness};
use crate::metrics::{HttpLabels, RouteLabel};
use crate::port::Port;
use crate::store::MapProgress;
use crate::trace::usual_method;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
const CLASSIC: &str = "text/plain; version=0.0.4; charset=utf-8";

/// `GET /healthz`: whether a restart would help
#[utoipa::path(
    get,
    path = "/healthz",
    operation_id = "getHealth",
    tag = "service",
    summary = "Whether the process is alive, or only a restart helps.",
    description = "",
    responses(
        (status = 200, description = "Alive.", body = AliveAnswer),
        (status = 503, description = "Something hangs.", body = AliveAnswer),
    )
)]
pub async fn healthz(State(app): State<Arc<App>>) -> impl IntoResponse {
    let hang = app.state.store.hang();
    let status = if hang.is_none() { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let body = Json(AliveAnswer { alive: hang.is_none(), reason: hang });
    (status, [(header::CACHE_CONTROL, "no-store")], body)
}

/// `GET /readyz`: whether vehicles can be localized. What else is not well is in the body
#[utoipa::path(
    get,
    path = "/readyz",
    operation_id = "getReadiness",
    tag = "service",
    summary = "Whether requests are welcome, or why not.",
    description = "",
    responses(
        (status = 200, description = "Vehicles can be localized; what else is not well is told.", body = ReadyAnswer),
        (status = 503, description = "They cannot.", body = ReadyAnswer),
    )
)]
pub async fn readyz(State(app): State<Arc<App>>) -> impl IntoResponse {
    let readiness = app.state.health.get();
    let ready = readiness.localizing.is_ready();
    let status = if ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let body = ReadyAnswer {
        readiness: readiness_answer(&readiness, &app.state.store.progress().borrow()),
        // Told wherever somebody looks: it is meant, or a mistake.
        anonymous: app.gate.anonymous().map(|roles| roles.to_string()),
    };
    (status, [(header::CACHE_CONTROL, "no-store")], Json(body))
}

/// The readiness, with the epoch that is served and the last one that was journaled.
pub fn readiness_answer(readiness: &ServiceReadiness, progress: &MapProgress) -> ReadinessAnswer {
    let ServiceReadiness { localizing, uploading } = readiness;
    let of = |readiness: &Readiness| PartReadiness {
        ready: readiness.is_ready(),
        reason: readiness.reason().map(str::to_owned),
    };
    ReadinessAnswer {
        ready: localizing.is_ready(),
        reason: localizing.reason().or(uploading.reason()).map(str::to_owned),
        localizing: of(localizing),
        uploading: of(uploading),
        epoch: progress.epoch,
        journaled: progress.journaled,
    }
}

/// `GET /metrics`
#[utoipa::path(
    get,
    path = "/metrics",
    operation_id = "getMetrics",
    tag = "service",
    summary = "What the service counts.",
    description = "",
    responses(
        (status = 200, description = "In the format that `Accept` names; OpenMetrics without one.", content((String = "application/openmetrics-text"), (String = "text/plain"))),
    )
)]
pub async fn metrics(State(app): State<Arc<App>>, headers: HeaderMap) -> impl IntoResponse {
    let accepted = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let accepted = accepted.collect::<Vec<_>>().join(",").to_ascii_lowercase();
    // Who names only the older format knows no other.
    let classic = accepted.contains("text/plain") && !accepted.contains("application/openmetrics-text");
    let vary = (header::VARY, "accept");
    if classic {
        return ([(header::CONTENT_TYPE, CLASSIC), vary], app.state.metrics.render_classic());
    }
    ([(header::CONTENT_TYPE, OPEN_METRICS), vary], app.state.metrics.render())
}

/// Counts a request by its route, never by its path, and takes its time.
pub async fn counted(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let route = Port::Http.call(&request).to_owned();
    let method = usual_method(request.method()).unwrap_or("other");
    let began = Instant::now();
    let answer = next.run(request).await;
    let metrics = &app.state.metrics;
    let seconds = metrics.http_seconds.get_or_create_owned(&RouteLabel { route: route.clone() });
    seconds.observe(began.elapsed().as_secs_f64());
    metrics.http.get_or_create(&HttpLabels { method, route, status: answer.status().as_u16() }).inc();
    answer
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::{TestSite, json_of};
    use axum::http::Method;
    use serde_json::json;

    #[tokio::test]
    async fn metrics_come_in_the_format_that_is_accepted() {
        let site = TestSite::default();
        for (accept, kind) in [
            ("*/*", OPEN_METRICS),
            ("text/plain;version=0.0.4;q=0.5,*/*;q=0.1", CLASSIC),
            ("application/openmetrics-text;version=1.0.0,text/plain;version=0.0.4;q=0.5", OPEN_METRICS),
        ] {
            let answer = site.send(Method::GET, "/metrics", &[("accept", accept)]).await;
            assert_eq!(answer.headers()["content-type"], kind, "{accept}");
        }
    }

    /// Catches: requests that are told apart by what callers write into their paths.
    #[tokio::test]
    async fn requests_are_counted_by_route() {
        let site = TestSite::default();
        for path in ["/api/v1/tiles/32614/1/2", "/api/v1/tiles/32614/3/4", "/nowhere", "/nowhere/else"] {
            site.get(path).await;
        }
        let text = site.state.metrics.render();
        let count = |route: &str, status| {
            let labels = format!("method=\"GET\",route=\"{route}\",status=\"{status}\"");
            text.contains(&format!("echofix_http_requests_total{{{labels}}} 2\n"))
        };
        assert!(count("/api/v1/tiles/{epsg}/{x}/{y}", 404) && count("unknown", 404), "{text}");
        assert!(!text.contains("32614") && !text.contains("nowhere"), "{text}");
    }

    #[tokio::test]
    async fn readiness_says_why_not() {
        let site = TestSite::default();
        assert_eq!(site.get("/healthz").await.status(), 200);
        let response = site.get("/readyz").await;
        assert_eq!(response.status(), 503);
        assert_eq!(json_of(response).await["reason"], "starting");
        site.state.health.ready();
        let response = site.get("/readyz").await;
        assert_eq!(response.status(), 200);
        let body = json_of(response).await;
        assert!(
            body["ready"] == true && body["uploading"]["ready"] == true && body["epoch"].is_u64(),
            "{body}"
        );
    }

    /// Catches: a full disk that takes a service out of rotation whose map can be localized against.
    #[tokio::test]
    async fn a_service_that_takes_no_uploads_still_localizes() {
        let site = TestSite::default();
        let full = Readiness::NotReady("the disk is full".to_owned());
        site.state.health.set(ServiceReadiness { localizing: Readiness::Ready, uploading: full });
        let response = site.get("/readyz").await;
        assert_eq!(response.status(), 200);
        let body = json_of(response).await;
        assert_eq!(
            (&body["reason"], &body["localizing"]["ready"]),
            (&json!("the disk is full"), &json!(true))
        );
        assert_eq!(body["uploading"]["ready"], false);
    }

    #[tokio::test]
    async fn metrics_are_open_metrics() {
        let response = TestSite::default().get("/metrics").await;
        let kind = response.headers()["content-type"].to_str().unwrap().to_owned();
        assert!(kind.starts_with("application/openmetrics-text; version=1.0.0"), "{kind}");
    }
}
