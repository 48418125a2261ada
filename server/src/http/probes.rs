//! Alive, ready, counted.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde_json::{Value, json};

use super::App;
use crate::health::{Readiness, ServiceReadiness};
use crate::store::MapProgress;

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// `GET /healthz`: whether a restart would help
pub async fn healthz(State(app): State<Arc<App>>) -> impl IntoResponse {
    let hang = app.state.store.hang();
    let status = if hang.is_none() { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let body = Json(json!({ "alive": hang.is_none(), "reason": hang }));
    (status, [(header::CACHE_CONTROL, "no-store")], body)
}

/// `GET /readyz`: whether vehicles can be localized. What else is not well is in the body
pub async fn readyz(State(app): State<Arc<App>>) -> impl IntoResponse {
    let readiness = app.state.health.get();
    let ready = readiness.localizing.is_ready();
    let status = if ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let mut body = readiness_json(&readiness, &app.state.store.progress().borrow());
    // Told wherever somebody looks: it is meant, or a mistake.
    body["anonymous"] = app.gate.anonymous().map(|roles| roles.to_string()).into();
    (status, [(header::CACHE_CONTROL, "no-store")], Json(body))
}

/// The readiness as JSON, with the epoch that is served and the last one that was journaled.
pub fn readiness_json(readiness: &ServiceReadiness, progress: &MapProgress) -> Value {
    let ServiceReadiness { localizing, uploading } = readiness;
    let of = |readiness: &Readiness| json!({ "ready": readiness.is_ready(), "reason": readiness.reason() });
    json!({
        "ready": localizing.is_ready(),
        "reason": localizing.reason().or(uploading.reason()),
        "localizing": of(localizing),
        "uploading": of(uploading),
        "epoch": progress.epoch,
        "journaled": progress.journaled,
    })
}

/// `GET /metrics`
pub async fn metrics(State(app): State<Arc<App>>) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, OPEN_METRICS)], app.state.metrics.render())
}

#[cfg(test)]
mod tests {
    use super::*;
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
