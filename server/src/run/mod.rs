//! The service as a whole: two ports over one store, from bind to the last answer.
//!
//! - [`calls`]: what holds for every call of the vehicles' port.
//! - [`connections`]: which connections are let in, and for how long they may say nothing.
//! - [`grpc`], [`http`]: the two ports.
//! - [`counted`]: each gRPC call is counted.
//! - [`listener`]: addresses of the network, and unix sockets.
//! - [`figures`]: what is looked up when somebody reads the metrics.
//! - [`follow`]: health and metrics follow the store.
//! - [`routing`]: calls that are better asked of another service are told so.
//! - [`retention`]: old uploads are compacted.
//! - [`quarantine`]: what vetting keeps out is told.
//! - [`webhook`]: alarms are sent to where somebody is woken.
//! - [`signals`]: when to end.

mod calls;
mod connections;
mod counted;
mod figures;
mod follow;
mod grpc;
mod http;
mod listener;
mod quarantine;
mod retention;
mod routing;
mod signals;
mod webhook;

use std::future::Future;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use serde::Serialize;
use tokio::sync::watch;

use crate::config::{self, Config, HttpConfig, ListenConfig};
use crate::feed::Feed;
use crate::health::Health;
use crate::identity::{self, Gate, Rates};
use crate::lanes::Lanes;
use crate::listen::{ListenAddress, socket_mode};
use crate::locating::Expectations;
use crate::metrics::Metrics;
use crate::store::{self, EmbeddedStore, MapStore, Operations, Options, ReplicatedStore};
use listener::Listener;
pub use signals::signalled;

/// Why the service cannot run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A port is not to be had.
    #[error("cannot listen on {address} for {port}: {source}")]
    Listen {
        /// The address that was to be bound.
        address: ListenAddress,
        /// The port's protocol.
        port: &'static str,
        /// What the operating system reported.
        source: io::Error,
    },
    /// The store does not open.
    #[error("cannot open the store in {dir}: {source}")]
    Store {
        /// The data directory, or the bucket.
        dir: String,
        /// Why it does not open.
        source: store::Error,
    },
    /// The file with the addresses cannot be written.
    #[error("cannot write {path}: {source}")]
    AddressFile {
        /// The file that was named by `--addr-file`.
        path: String,
        /// What the operating system reported.
        source: io::Error,
    },
    /// Nobody can be let in as configured.
    #[error(transparent)]
    Identity(#[from] identity::Error),
    /// The gRPC port failed.
    #[error("the gRPC port failed: {0}")]
    Grpc(#[from] tonic::transport::Error),
    /// The reflection service cannot be set up.
    #[error("the reflection service cannot be set up: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
    /// The system has no threads left.
    #[error("cannot start the service's threads: {0}")]
    Threads(io::Error),
    /// A task of the service ended before its time.
    #[error("the service ended unexpectedly: {0}")]
    Task(#[from] tokio::task::JoinError),
}

/// What both ports answer from.
#[derive(Clone)]
struct ServiceContext {
    config: Arc<Config>,
    store: Arc<dyn MapStore>,
    expectations: Arc<Expectations>,
    operations: Arc<dyn Operations>,
    feed: Arc<Feed>,
    metrics: Arc<Metrics>,
    health: Arc<Health>,
    lanes: Lanes,
    gate: Arc<Gate>,
    rates: Arc<Rates>,
}

/// Frames that may come for calls which the service has ended itself, before the HTTP/2 library ends their connection. Bodies of
/// refused calls are received for a while, so that there are few.
const LATE_FRAMES: usize = 1024;

/// How long the end waits for the store to close.
const CLOSES_WITHIN: Duration = Duration::from_millis(700);

/// A service that has its ports and its store, and answers once it is run.
pub struct Server {
    shared: ServiceContext,
    grpc: Listener,
    http: Listener,
    addresses: Addresses,
}

/// Where a server listens.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Addresses {
    /// The gRPC port, for vehicles.
    pub grpc: ListenAddress,
    /// The HTTP port, for operators.
    pub http: ListenAddress,
}

impl Server {
    /// Takes the ports and opens the store, which checks all of the journal.
    ///
    /// # Errors
    /// When nobody can be let in as configured, a port is taken, or the store is damaged or in use.
    pub async fn bind(config: Config) -> Result<Self, Error> {
        let (gate, rates) = (config.gate()?, Rates::of(&config.rates));
        let ListenConfig { listen: address, socket_mode } = &config.grpc;
        let (grpc, grpc_address) = listen(address, socket_mode, "gRPC").await?;
        let HttpConfig { listen: address, socket_mode, .. } = &config.http;
        let (http, http_address) = listen(address, socket_mode, "HTTP").await?;
        let addresses = Addresses { grpc: grpc_address, http: http_address };
        let (dir, bucket) = (config.store.directory(), config.store.bucket());
        let options = Options {
            table: config.store.table,
            cache_bytes: config.store.cache_mib << 20,
            segment_bytes: config.store.segment_mib << 20,
            announce: config.store.announced(),
            ..Options::new(dir.clone(), config.mapping.policy())
        };
        let lanes = Lanes::start().map_err(Error::Threads)?;
        let shown = bucket.clone().unwrap_or_else(|| dir.display().to_string());
        let opened = tokio::task::spawn_blocking(move || opened(bucket.as_deref(), &options)).await?;
        let (store, operations) = opened.map_err(|source| Error::Store { dir: shown, source })?;
        let (search, integrity) = (config.locating.search(), config.locating.integrity());
        let shared = ServiceContext {
            expectations: Arc::new(Expectations::new(Arc::clone(&store), search, integrity)),
            config: Arc::new(config),
            operations,
            store,
            feed: Arc::default(),
            metrics: Arc::default(),
            health: Arc::default(),
            gate: Arc::new(gate),
            rates: Arc::new(rates),
            lanes,
        };
        figures::of_store(&shared);
        Ok(Self { shared, grpc, http, addresses })
    }

    /// Where vehicles and operators connect.
    #[must_use]
    pub fn addresses(&self) -> &Addresses {
        &self.addresses
    }

    /// Answers until `shutdown`, then until the requests in flight are answered, but no longer
    /// than configured.
    ///
    /// # Errors
    /// When a port fails.
    pub async fn run(self, shutdown: impl Future<Output = ()> + Send) -> Result<(), Error> {
        let Self { shared, grpc, http, addresses } = self;
        let grace = Duration::from_secs(shared.config.limits.shutdown_s);
        let ending = watch::Sender::new(false);
        let follower = tokio::spawn(follow::follow(shared.clone()));
        let Lanes { port, background, .. } = shared.lanes.clone();
        let retention = background.spawn(retention::keep(shared.clone()));
        let quarantine = background.spawn(quarantine::tell(shared.clone()));
        let identities =
            background.spawn(identity::keep_current(shared.gate.clone(), shared.metrics.clone()));
        let keys = background.spawn(identity::keep_keys(shared.gate.clone(), shared.metrics.clone()));
        let mut grpc = port.spawn(grpc::serve(grpc, shared.clone(), ending.subscribe()));
        let mut http =
            background.spawn(http::serve((http, addresses.http), shared.clone(), ending.subscribe()));
        tokio::select! {
            () = shutdown => {}
            result = &mut grpc => return result?,
            result = &mut http => return Ok(result?),
        }
        tracing::info!("draining");
        follower.abort();
        retention.abort();
        quarantine.abort();
        identities.abort();
        keys.abort();
        // An aborted task may still be in its last step: it must not call the service ready again.
        let _ = follower.await;
        shared.health.not_ready("draining");
        ending.send_replace(true);
        shared.operations.wind_down();
        let drained = tokio::time::timeout(grace, async { (grpc.await, http.await) }).await;
        let_go(shared).await;
        let Ok((grpc, http)) = drained else {
            tracing::warn!(grace_s = grace.as_secs(), "ending with requests in flight");
            return Ok(());
        };
        grpc??;
        http?;
        tracing::info!("drained");
        Ok(())
    }
}

/// Binds and runs a service that was built from a commit; reports what runs and where it listens in the log and, if asked, the
/// addresses as JSON in a file.
///
/// # Errors
/// When it cannot start, or a port fails.
pub async fn serve(
    config: Config,
    commit: &str,
    address_file: Option<&Path>,
    shutdown: impl Future<Output = ()> + Send,
) -> Result<(), Error> {
    tokio::pin!(shutdown);
    let server = tokio::select! {
        bound = Server::bind(config) => bound?,
        () = &mut shutdown => {
            tracing::info!("ending before the store is open");
            return Ok(());
        }
    };
    server.shared.metrics.built_from(commit);
    tell(&server.shared.config, server.addresses(), commit);
    if let Some(roles) = server.shared.gate.anonymous() {
        tracing::warn!(%roles, "anybody who reaches the ports has these roles (`identity.anonymous`)");
    }
    if let Some(path) = address_file {
        let failed = |source| Error::AddressFile { path: path.display().to_string(), source };
        write_whole(path, server.addresses()).map_err(failed)?;
    }
    server.run(shutdown).await
}

/// One line that says what runs here.
fn tell(config: &Config, addresses: &Addresses, commit: &str) {
    let Addresses { grpc, http } = addresses;
    let bucket = config.store.bucket().map(|url| config::without_credentials(&url));
    let store = bucket.unwrap_or_else(|| config.store.directory().display().to_string());
    let (version, differing) = (env!("CARGO_PKG_VERSION"), config.differences().join(" "));
    tracing::info!(version, commit, %grpc, %http, store, differing, "listening");
}

/// Closes the store, if nothing else holds it, but does not wait for long: what is being folded is folded again at the next
/// start.
async fn let_go(shared: ServiceContext) {
    let closing = tokio::task::spawn_blocking(move || drop(shared));
    if tokio::time::timeout(CLOSES_WITHIN, closing).await.is_err() {
        tracing::info!("ending while an upload is being folded");
    }
}

/// Replaces the file in one step: a program that waits for it never reads half of it.
fn write_whole(path: &Path, addresses: &Addresses) -> io::Result<()> {
    let unnamed = path.with_extension("new");
    std::fs::write(&unnamed, serde_json::to_vec(addresses)?)?;
    std::fs::rename(unnamed, path)
}

type Opened = (Arc<dyn MapStore>, Arc<dyn Operations>);

/// The store of a bucket, or of a directory.
fn opened(bucket: Option<&str>, options: &Options) -> Result<Opened, store::Error> {
    if let Some(url) = bucket {
        let store = Arc::new(ReplicatedStore::open(url, options)?);
        return Ok((store.clone(), store));
    }
    let store = Arc::new(EmbeddedStore::open(options)?);
    Ok((store.clone(), store))
}

async fn listen(
    address: &ListenAddress,
    mode: &str,
    port: &'static str,
) -> Result<(Listener, ListenAddress), Error> {
    // Checked with the configuration; nobody but the service itself, were it not.
    let bound = Listener::bind(address, socket_mode(mode).unwrap_or(0o600)).await;
    bound.map_err(|source| Error::Listen { address: address.clone(), port, source })
}

/// Resolves when the end is called, or its sender is gone.
async fn ended(mut ending: watch::Receiver<bool>) {
    let _ = ending.wait_for(|ending| *ending).await;
}
