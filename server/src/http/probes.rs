//! Alive, ready, counted.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde_json::{Value, json};

use super::App;
use crate::health::Readiness;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// `GET /healthz`
pub async fn healthz() -> impl IntoResponse {
    Json(json!({ "alive": true }))
}

/// `GET /readyz`
pub async fn readyz(State(app): State<Arc<App>>) -> impl IntoResponse {
    let readiness = app.state.health.get();
    let status = match readiness {
        Readiness::Ready => StatusCode::OK,
        Readiness::NotReady(_) => StatusCode::SERVICE_UNAVAILABLE,
    };
    (status, [(header::CACHE_CONTROL, "no-store")], Json(readiness_json(&readiness)))
}

/// The readiness as JSON.
pub fn readiness_json(readiness: &Readiness) -> Value {
    match readiness {
        Readiness::Ready => json!({ "ready": true, "reason": null }),
        Readiness::NotReady(reason) => json!({ "ready": false, "reason": reason }),
    }
}

/// `GET /metrics`
pub async fn metrics(State(app): State<Arc<App>>) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, OPEN_METRICS)], app.state.metrics.render())
}

#[cfg(test)]
mod tests {
    use crate::http::testing::{TestSite, json_of};

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
        assert_eq!(json_of(response).await["ready"], true);
    }

    #[tokio::test]
    async fn metrics_are_open_metrics() {
        let response = TestSite::default().get("/metrics").await;
        let kind = response.headers()["content-type"].to_str().unwrap().to_owned();
        assert!(kind.starts_with("application/openmetrics-text; version=1.0.0"), "{kind}");
    }
}
