//! The operators' port.

use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use hyper::body::{Body as HttpBody, Frame, Incoming, SizeHint};
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::sync::watch;
use tokio_stream::StreamExt;

use super::connections::{Acceptor, Door, InUse};
use super::listener::Listener;
use super::{LATE_FRAMES, ServiceContext, ended};
use crate::config::{HttpConfig, LimitsConfig};
use crate::http::{BaseMap, Hosts, HttpState, Origins, Place, router_at};
use crate::listen::ListenAddress;
use crate::pace::PacedBody;
use crate::port::Port;

/// Serves until the end is called and the requests in flight are answered.
pub(super) async fn serve(
    (listener, bound): (Listener, ListenAddress),
    shared: ServiceContext,
    ending: watch::Receiver<bool>,
) {
    let ServiceContext {
        config, store, operations, expectations, feed, metrics, health, gate, rates, ..
    } = shared;
    let limits = &config.limits;
    let counted = metrics.clone();
    let builder = builder(limits);
    let alarm_limits = config.alarms.limits();
    let (spool_dir, address_share, ending_too) =
        (config.store.data_dir.clone(), limits.address_share, ending.clone());
    let state = HttpState {
        store,
        operations,
        expectations,
        alarm_limits,
        feed,
        metrics,
        health,
        spool_dir,
        address_share,
        ending: ending.clone(),
    };
    let routes = router_at(state, place(&bound, &config.http), (gate.clone(), rates));
    let routes = TowerToHyperService::new(routes);
    let graceful = GracefulShutdown::new();
    let door = Door::new(gate, Port::Http);
    let mut connections = Acceptor::new(listener, limits, door, &counted).open();
    let ended = ended(ending);
    tokio::pin!(ended);
    loop {
        let connection = tokio::select! {
            connection = connections.next() => connection,
            () = &mut ended => None,
        };
        let Some(connection) = connection else { break };
        let (origin, routes, ending, pace) =
            (connection.origin.clone(), routes.clone(), ending_too.clone(), limits.pace());
        let service = service_fn(move |request: hyper::Request<Incoming>| {
            let held = origin.used.begin();
            let mut request = request.map(|body| PacedBody::new(body, Some(pace), ending.clone()));
            request.extensions_mut().insert(origin.used.peer());
            request.extensions_mut().insert(std::sync::Arc::clone(origin.end()));
            let answer = routes.call(request);
            async move { Ok::<_, Infallible>(answer.await?.map(|body| UsingBody { body, _held: held })) }
        });
        let served = builder.serve_connection(TokioIo::new(connection), service).into_owned();
        let served = graceful.watch(served);
        tokio::spawn(async move {
            if let Err(error) = served.await {
                tracing::debug!(error, "an HTTP connection ended early");
            }
        });
    }
    drop(connections);
    graceful.shutdown().await;
}

/// Where the port is found, and by whose pages.
fn place(bound: &ListenAddress, config: &HttpConfig) -> Place {
    let HttpConfig {
        hosts, base_path, cors_origins, base_map, base_map_attribution, base_map_max_zoom, ..
    } = config;
    Place {
        hosts: Hosts::of(bound.ip(), hosts),
        base_path: base_path.clone(),
        origins: Origins::of(cors_origins),
        base_map: BaseMap::of(base_map, base_map_attribution, *base_map_max_zoom),
    }
}

fn builder(limits: &LimitsConfig) -> auto::Builder<TokioExecutor> {
    let mut builder = auto::Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(limits.handshake()).max_buf_size(64 << 10);
    builder
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(limits.streams_per_connection)
        .max_header_list_size(limits.header_bytes)
        .max_pending_accept_reset_streams(limits.resets_per_connection)
        .max_local_error_reset_streams(LATE_FRAMES)
        .keep_alive_interval(limits.keepalive())
        .keep_alive_timeout(limits.keepalive_timeout());
    builder
}

/// The body of an answer. While it is there its connection is in use.
struct UsingBody {
    body: Body,
    _held: InUse,
}

impl HttpBody for UsingBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
