//! The operators' port.

use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_stream::StreamExt;

use super::connections::{Acceptor, Door};
use super::{ServiceContext, ended};
use crate::config::LimitsConfig;
use crate::http::{Hosts, HttpState, router_at};
use crate::identity::Port;

/// Serves until the end is called and the requests in flight are answered.
pub(super) async fn serve(listener: TcpListener, shared: ServiceContext, ending: watch::Receiver<bool>) {
    let ServiceContext { config, store, operations, expectations, feed, metrics, health, gate, .. } = shared;
    let limits = &config.limits;
    let builder = builder(limits);
    let alarm_limits = config.alarms.limits();
    let state = HttpState {
        store,
        operations,
        expectations,
        alarm_limits,
        feed,
        metrics,
        health,
        ending: ending.clone(),
    };
    let routes = match listener.local_addr() {
        Ok(bound) => router_at(state, Hosts::of(bound, &config.http.hosts), gate.clone()),
        Err(error) => return tracing::error!(%error, "the HTTP port has no address"),
    };
    let routes = TowerToHyperService::new(routes);
    let graceful = GracefulShutdown::new();
    let door = Door::new(gate, Port::Http);
    let mut connections = Acceptor::new(listener, limits.connections, limits.handshake(), door).open();
    let ended = ended(ending);
    tokio::pin!(ended);
    loop {
        let connection = tokio::select! {
            connection = connections.next() => connection,
            () = &mut ended => None,
        };
        let Some(connection) = connection else { break };
        let (first_request, routes) = (connection.first_request.clone(), routes.clone());
        let service = service_fn(move |mut request: hyper::Request<_>| {
            first_request.came();
            request.extensions_mut().insert(std::sync::Arc::clone(first_request.peer()));
            routes.call(request)
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

fn builder(limits: &LimitsConfig) -> auto::Builder<TokioExecutor> {
    let mut builder = auto::Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(limits.handshake()).max_buf_size(64 << 10);
    builder
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(limits.streams_per_connection)
        .max_header_list_size(limits.header_bytes)
        .max_pending_accept_reset_streams(limits.resets_per_connection)
        .max_local_error_reset_streams(limits.resets_per_connection)
        .keep_alive_interval(limits.keepalive())
        .keep_alive_timeout(limits.keepalive_timeout());
    builder
}
