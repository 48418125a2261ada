//! The vehicles' port. tonic leaves most limits open: each is set here.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use echofix_proto::v1::FILE_DESCRIPTOR_SET;
use echofix_proto::v1::localization_service_server::LocalizationServiceServer;
use echofix_proto::v1::map_service_server::MapServiceServer;
use echofix_proto::v1::mapping_service_server::MappingServiceServer;
use tokio::sync::watch;
use tokio_stream::StreamExt;
use tonic::codec::CompressionEncoding::{Gzip, Zstd};
use tonic::server::NamedService;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use tower::util::MapResponseLayer;

use super::calls::{CallsLayer, STREAM_WINDOW};
use super::connections::{Acceptor, Door};
use super::counted::CountedLayer;
use super::listener::Listener;
use super::routing::RoutingLayer;
use super::{Error, LATE_FRAMES, ServiceContext, ended, figures};
use crate::access_log::AccessLogLayer;
use crate::config::LimitsConfig;
use crate::grpc::{Access, Admission, HeadsLayer, LocalizationApi, MapApi, MappingApi, tell_faults};
use crate::health::Readiness;
use crate::locating::Locator;
use crate::port::Port;
use crate::trace::RequestSpanLayer;

/// The same of all streams of a connection.
const CONNECTION_WINDOW: u32 = 4 << 20;
/// Bytes of an answer: a piece of a tile stays far below, and so do the names of all tiles of an area.
const MAX_ANSWER: usize = 4 << 20;
/// Bytes of a question about the service itself: the name of a symbol, a file or a service.
const MAX_NAME: usize = 512;

/// Serves until the end is called and the requests in flight are answered.
pub(super) async fn serve(
    listener: Listener,
    shared: ServiceContext,
    ending: watch::Receiver<bool>,
) -> Result<(), Error> {
    let LimitsConfig { message_bytes, reads_at_once, address_share, .. } = shared.config.limits;
    let (limits, ServiceContext { store, expectations, feed, metrics, lanes, .. }) =
        (&shared.config.limits, &shared);

    let mapping = shared.config.mapping.clone();
    let demand = mapping.demand();
    let shared_by = (address_share, lanes.clone());
    let mapping = MappingApi::new(store.clone(), feed.clone(), metrics.clone(), mapping, shared_by);
    let mapping = MappingServiceServer::new(mapping)
        .max_decoding_message_size(message_bytes)
        .max_encoding_message_size(MAX_ANSWER)
        .accept_compressed(Gzip)
        .accept_compressed(Zstd);
    let locator = Arc::new(Locator::new(store.clone(), shared.config.locating));
    figures::of_cache(metrics, &locator);
    let kept_bytes = usize::try_from(shared.config.locating.stream_batches_mib << 20).unwrap_or(usize::MAX);
    let localization = LocalizationApi::new(locator.clone(), feed.clone(), metrics.clone())
        .on(lanes.clone())
        .keeping(kept_bytes, address_share);
    let localization = LocalizationServiceServer::new(localization)
        .max_decoding_message_size(message_bytes)
        .accept_compressed(Gzip)
        .accept_compressed(Zstd);
    let map = MapApi::new(
        store.clone(),
        (expectations.clone(), demand),
        (reads_at_once, address_share),
        (limits.pace(), lanes.clone()),
    );
    let map = MapServiceServer::new(map)
        .max_decoding_message_size(message_bytes)
        .max_encoding_message_size(MAX_ANSWER)
        .accept_compressed(Gzip)
        .accept_compressed(Zstd);
    let (reporter, health) = tonic_health::server::health_reporter();
    let follower = tokio::spawn(follow(reporter, shared.clone()));
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        .build_v1()?
        // Whoever asks for a symbol is told its name again: in the answer, or in the trailers.
        .max_decoding_message_size(MAX_NAME)
        .max_encoding_message_size(MAX_ANSWER);
    let health = health.max_decoding_message_size(MAX_NAME);

    let door = Door::new(shared.gate.clone(), Port::Grpc);
    let acceptor = Acceptor::new(listener, limits, door, metrics);
    let served = limited(limits)
        .layer(AccessLogLayer(Port::Grpc))
        .layer(RequestSpanLayer::grpc())
        .layer(CountedLayer(metrics.clone()))
        .layer(CallsLayer::new(limits.pace(), ending.clone()))
        .layer(MapResponseLayer::new(tell_faults(metrics.clone())))
        .layer(HeadsLayer(Access::new(shared.gate.clone(), shared.rates.clone())))
        .layer(RoutingLayer::of(store.as_ref(), &shared.config.store.announce))
        .layer(HeadsLayer(Admission::new(locator, metrics.clone())))
        .add_service(localization)
        .add_service(mapping)
        .add_service(map)
        .add_service(health)
        .add_service(reflection)
        .serve_with_incoming_shutdown(acceptor.open().map(io::Result::Ok), ended(ending))
        .await;
    follower.abort();
    Ok(served?)
}

/// Every limit tonic offers.
fn limited(limits: &LimitsConfig) -> tonic::transport::Server {
    let requests = limits.streams_per_connection;
    tonic::transport::Server::builder()
        .max_concurrent_streams(requests)
        .concurrency_limit_per_connection(requests as usize)
        .load_shed(true)
        .timeout(Duration::from_secs(limits.request_s))
        .http2_max_header_list_size(limits.header_bytes)
        .http2_max_pending_accept_reset_streams(Some(limits.resets_per_connection))
        .http2_max_local_error_reset_streams(Some(LATE_FRAMES))
        .http2_keepalive_interval(Some(limits.keepalive()))
        .http2_keepalive_timeout(Some(limits.keepalive_timeout()))
        .initial_stream_window_size(STREAM_WINDOW)
        .initial_connection_window_size(CONNECTION_WINDOW)
}

/// What the health service says follows what the service knows.
async fn follow(reporter: HealthReporter, shared: ServiceContext) {
    let localizing = [
        "",
        <LocalizationServiceServer<LocalizationApi> as NamedService>::NAME,
        <MapServiceServer<MapApi> as NamedService>::NAME,
    ];
    let uploading = <MappingServiceServer<MappingApi> as NamedService>::NAME;
    let status = |readiness: &Readiness| {
        if readiness.is_ready() { ServingStatus::Serving } else { ServingStatus::NotServing }
    };
    let mut readiness = shared.health.follow();
    loop {
        let now = readiness.borrow_and_update().clone();
        for service in localizing {
            reporter.set_service_status(service, status(&now.localizing)).await;
        }
        reporter.set_service_status(uploading, status(&now.uploading)).await;
        if readiness.changed().await.is_err() {
            return;
        }
    }
}
