//! What metrics are told apart by. Each set of labels is bounded: by the service's own words, methods and routes.

use prometheus_client::encoding::EncodeLabelSet;

/// Which build runs.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct BuildLabels {
    /// Its version.
    pub version: &'static str,
    /// The commit that it was built from.
    pub commit: String,
}

/// What came of a request: a verdict, `COUNTED`, or the reason of a refusal.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct OutcomeLabel {
    /// One of a fixed set of words.
    pub outcome: &'static str,
}

/// Why the service refused.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct ReasonLabel {
    /// One of the reasons that the service's own refusals name.
    pub reason: String,
}

/// A port.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct PortLabel {
    /// `grpc` or `http`.
    pub port: &'static str,
}

/// A gRPC method.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct MethodLabel {
    /// Its path, or `unknown`.
    pub method: &'static str,
}

/// A gRPC method and how its call ended.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct RpcLabels {
    /// Its path, or `unknown`.
    pub method: &'static str,
    /// gRPC's code.
    pub code: &'static str,
}

/// A route of HTTP.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct RouteLabel {
    /// Its pattern, parameters in braces, or `unknown`.
    pub route: String,
}

/// An HTTP request.
#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct HttpLabels {
    /// The method, or `other`.
    pub method: &'static str,
    /// The route's pattern, parameters in braces, or `unknown`.
    pub route: String,
    /// The status of the answer.
    pub status: u16,
}
