//! Spans of calls to an OpenTelemetry collector, where one is configured: which call, its code, the caller's role, and what of the
//! work took how long. Never who, nor where.
//!
//! A thread of its own sends them. What a collector that is slow or away does not take is dropped: no call waits for it.

use std::fmt::Display;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::http::HeaderMap;
use opentelemetry::KeyValue;
use opentelemetry::propagation::{Extractor, TextMapPropagator};
use opentelemetry::trace::{SpanKind, Status, TracerProvider};
use opentelemetry_otlp::{ExporterBuildError, SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::{BatchSpanProcessor, SdkTracerProvider, SpanData, SpanExporter as Exporter};
use serde::{Deserialize, Serialize};
use tracing::Span;
use tracing_opentelemetry::OpenTelemetrySpanExt;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::registry::LookupSpan;
use uuid::Uuid;

/// The target of spans that are exported and stand in no log line.
pub const TARGET: &str = "export";
/// Spans of calls, which stand in log lines, too.
const CALLS: [&str; 2] = ["rpc", "http"];
/// How long a collector may take for what it is sent.
const SENT_WITHIN: Duration = Duration::from_secs(3);
/// How long the end waits for the last spans to be sent.
const FLUSHED_WITHIN: Duration = Duration::from_secs(1);

/// Where spans of calls are sent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TraceConfig {
    /// A collector that takes OTLP over gRPC, `http://` and its address; empty: what the environment names.
    pub otlp_endpoint: String,
}

impl TraceConfig {
    /// The collector; empty without one.
    #[must_use]
    pub fn endpoint(&self) -> String {
        if self.otlp_endpoint.is_empty() {
            return std::env::var("OTEL_EXPORTER_OTLP_ENDPOINT").unwrap_or_default();
        }
        self.otlp_endpoint.clone()
    }
}

static EXPORTING: AtomicBool = AtomicBool::new(false);

/// The span of a part of a call's work, which is exported with it.
macro_rules! part {
    ($name:literal) => {
        tracing::info_span!(target: $crate::export::TARGET, $name)
    };
}
pub(crate) use part;

/// Spans are exported, until this is ended.
pub struct Exporting(SdkTracerProvider);

impl Exporting {
    /// Begins, where the configuration names a collector. Call it within a runtime, which sends.
    ///
    /// # Errors
    /// When the endpoint is no address.
    pub fn begin(config: &TraceConfig) -> Result<Option<Self>, ExporterBuildError> {
        let endpoint = config.endpoint();
        if endpoint.is_empty() {
            return Ok(None);
        }
        let exporter =
            SpanExporter::builder().with_tonic().with_endpoint(endpoint).with_timeout(SENT_WITHIN).build()?;
        // `OTEL_SERVICE_NAME` and `OTEL_RESOURCE_ATTRIBUTES` count, too.
        let mut resource = Resource::builder();
        if std::env::var_os("OTEL_SERVICE_NAME").is_none() {
            resource = resource.with_service_name("echofix");
        }
        let resource = resource
            .with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")))
            .with_attribute(KeyValue::new("service.instance.id", Uuid::now_v7().to_string()));
        let provider = SdkTracerProvider::builder()
            .with_resource(resource.build())
            .with_span_processor(BatchSpanProcessor::builder(Named(exporter)).build())
            .build();
        EXPORTING.store(true, Ordering::Relaxed);
        Ok(Some(Self(provider)))
    }

    /// What hands spans on.
    pub fn layer<S>(&self) -> impl Layer<S> + Send + Sync + use<S>
    where
        S: tracing::Subscriber + for<'span> LookupSpan<'span> + Send + Sync,
    {
        let ours = filter_fn(|about| {
            about.is_span()
                && (about.target() == TARGET
                    || (about.target().starts_with("echofix_server") && CALLS.contains(&about.name())))
        });
        tracing_opentelemetry::layer()
            .with_tracer(self.0.tracer("echofix"))
            .with_location(false)
            .with_threads(false)
            .with_tracked_inactivity(false)
            .with_filter(ours)
    }
}

/// Sends what is left, for no more than a second. The runtime that sends must still be there.
impl Drop for Exporting {
    fn drop(&mut self) {
        EXPORTING.store(false, Ordering::Relaxed);
        if let Err(error) = self.0.shutdown_with_timeout(FLUSHED_WITHIN) {
            tracing::warn!(%error, "the last spans were not exported");
        }
    }
}

/// The span of a call becomes a part of the caller's trace, where its headers name one.
pub(crate) fn continue_trace(span: &Span, headers: &HeaderMap) {
    if EXPORTING.load(Ordering::Relaxed) && headers.contains_key("traceparent") {
        // A span that nobody exports has no parent there.
        let _ = span.set_parent(TraceContextPropagator::new().extract(&Headers(headers)));
    }
}

/// Notes how a call ended, or as what its caller is known.
pub(crate) fn note(span: &Span, key: &'static str, value: impl Display) {
    if EXPORTING.load(Ordering::Relaxed) {
        span.set_attribute(key, value.to_string());
    }
}

/// Notes that a call failed.
pub(crate) fn failed(span: &Span, code: &'static str) {
    if EXPORTING.load(Ordering::Relaxed) {
        span.set_status(Status::error(code));
    }
}

struct Headers<'a>(&'a HeaderMap);

impl Extractor for Headers<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key)?.to_str().ok()
    }

    fn keys(&self) -> Vec<&str> {
        self.0.keys().map(axum::http::HeaderName::as_str).collect()
    }
}

/// Names spans of calls by what was called.
#[derive(Debug)]
struct Named(SpanExporter);

impl Exporter for Named {
    async fn export(&self, mut batch: Vec<SpanData>) -> OTelSdkResult {
        for span in batch.iter_mut().filter(|span| CALLS.contains(&&*span.name)) {
            if let Some(call) = span.attributes.iter().find(|attribute| attribute.key.as_str() == "call") {
                span.name = call.value.to_string().trim_start_matches('/').to_owned().into();
            }
            span.span_kind = SpanKind::Server;
        }
        self.0.export(batch).await
    }

    fn shutdown_with_timeout(&self, timeout: Duration) -> OTelSdkResult {
        self.0.shutdown_with_timeout(timeout)
    }

    fn force_flush(&self) -> OTelSdkResult {
        self.0.force_flush()
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.0.set_resource(resource);
    }
}
