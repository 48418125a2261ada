//! The service's parts in this process, without sockets: how long each step of a request takes.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, anyhow};
use echofix_core::align::weights::TileWeights;
use echofix_core::batch::Batch;
use echofix_core::geo::{Grid, TileId};
use echofix_core::point::MapPoint;
use echofix_core::window::MapSquare;
use echofix_proto::v1::LocalizeRequest;
use echofix_server::args::{ServeArgs, key_and_value};
use echofix_server::config::Config;
use echofix_server::grpc::{LocalizationApi, decode};
use echofix_server::locating::Locator;
use echofix_server::store::{EmbeddedStore, MapStore, Options};
use prost::Message;
use serde::Serialize;

use super::case::Case;
use super::town::{BenchTown, TRUSTING};
use crate::request;
use echofix_harness::percentiles::Percentiles;
use echofix_harness::questions::DriveQuestions;

/// Number of requests that engines and steps are timed on.
const TIMED: usize = 8;

/// Name of the step that aligns.
pub(super) const ALIGNED: &str = "aligned";

/// Milliseconds of the steps of a request, on one thread.
#[derive(Debug, Clone, Serialize)]
pub struct Inside {
    /// Name and time of each step, in their order.
    pub steps: Vec<(&'static str, Percentiles)>,
    /// All steps together.
    pub total_ms: Percentiles,
}

impl Inside {
    /// The time of a step, by its name.
    pub(super) fn step(&self, name: &str) -> Option<Percentiles> {
        self.steps.iter().find(|(step, _)| *step == name).map(|(_, ms)| *ms)
    }
}

/// The service's store, locator and gRPC methods, in this process and without sockets.
pub(super) struct InProcessService {
    store: Arc<dyn MapStore>,
    config: Config,
    locator: Arc<Locator>,
    api: LocalizationApi,
    requests: Vec<LocalizeRequest>,
}

impl InProcessService {
    /// Opens the map in a folder. No service may have it open.
    ///
    /// # Errors
    /// When the map does not open.
    pub(super) fn open(town: &BenchTown, folder: &Path) -> anyhow::Result<Self> {
        // The setting of the service that made the map: under another policy the map would be folded anew.
        let settings = vec![key_and_value(TRUSTING)?];
        let config = ServeArgs { settings, ..ServeArgs::default() }.config()?;
        let options = Options {
            table: config.store.table,
            cache_bytes: config.store.cache_mib << 20,
            segment_bytes: config.store.segment_mib << 20,
            ..Options::new(folder.join("data"), config.mapping.policy())
        };
        let store: Arc<dyn MapStore> = Arc::new(EmbeddedStore::open(&options)?);
        let locator = Arc::new(Locator::new(Arc::clone(&store), config.locating));
        let api = LocalizationApi::new(Arc::clone(&locator), Arc::default(), Arc::default());
        Ok(Self { store, config, locator, api, requests: timed_of(&town.recording) })
    }

    /// The requests that engines and steps are timed on.
    pub(super) fn requests(&self) -> &[LocalizeRequest] {
        &self.requests
    }

    /// Half width of the search in a relocalization, metres.
    pub(super) fn wide_search_m(&self) -> f64 {
        self.config.locating.wide_search_m
    }

    /// Times the steps of every request, `repetitions` times.
    ///
    /// # Errors
    /// When a request is refused.
    pub(super) async fn profile(
        &self,
        requests: &[LocalizeRequest],
        repetitions: usize,
    ) -> anyhow::Result<Inside> {
        const STEPS: [&str; 7] = [
            "protobuf to columns",
            "columns checked",
            "scans organised",
            "window from the cache",
            ALIGNED,
            "answer, metrics, feed",
            "answer to protobuf",
        ];
        let mut times = Vec::new();
        for request in requests {
            let bytes = request.encode_to_vec();
            // The first request fills the cache.
            self.steps(&bytes).await?;
            for _ in 0..repetitions {
                times.push(self.steps(&bytes).await?);
            }
        }
        let percentiles = |of: &dyn Fn(&[f64; 7]) -> f64| {
            Percentiles::of(times.iter().map(of)).context("there is nothing to time")
        };
        let steps = STEPS.iter().enumerate().map(|(i, step)| Ok((*step, percentiles(&|times| times[i])?)));
        let steps = steps.collect::<anyhow::Result<_>>()?;
        Ok(Inside { steps, total_ms: percentiles(&|times| times.iter().sum())? })
    }

    /// Milliseconds of each step of one request.
    async fn steps(&self, bytes: &[u8]) -> anyhow::Result<[f64; 7]> {
        let (decoded_ms, request) = timed(|| LocalizeRequest::decode(bytes));
        let request = request?;
        let batch = request.batch.clone();
        let (checked_ms, batch) = timed(|| decode::batch(batch, "batch"));
        let (organised_ms, batch) = timed(|| self.organised(&batch?));
        batch?;
        let admitted = self.locator.admit().await?;
        let (work_ms, answer) = timed(|| self.api.work(request, admitted));
        let answer = answer.map_err(|status| anyhow!("a request was refused: {}", status.message()))?;
        let diagnostics = answer.diagnostics.unwrap_or_default();
        let (encoded_ms, _) = timed(|| answer.encode_to_vec());
        let (window_ms, align_ms) = (diagnostics.window_ms, diagnostics.align_ms);
        let rest_ms = work_ms - checked_ms - organised_ms - window_ms - align_ms;
        Ok([decoded_ms, checked_ms, organised_ms, window_ms, align_ms, rest_ms.max(0.0), encoded_ms])
    }

    fn organised(&self, batch: &decode::DecodedBatch) -> anyhow::Result<Batch> {
        let decode::DecodedBatch { reference_time_us, mounts, scans, odometry, .. } = batch;
        let gate = self.config.locating.gate();
        Ok(Batch::organise(scans.iter(), mounts, odometry, *reference_time_us, &gate)?)
    }

    /// The alignments that the engines are timed on.
    ///
    /// # Errors
    /// When a request is malformed or the map cannot be read.
    pub(super) fn cases(&self) -> anyhow::Result<Vec<Case>> {
        self.requests.iter().map(|request| self.case(request)).collect()
    }

    /// The alignment of a request.
    ///
    /// # Errors
    /// When the request is malformed or the map cannot be read.
    pub(super) fn case(&self, request: &LocalizeRequest) -> anyhow::Result<Case> {
        let batch = self.organised(&decode::batch(request.batch.clone(), "batch")?)?;
        let believed = request::believed(request);
        let (grid, search) = (Grid::of(believed.at)?, self.config.locating.search());
        let prior = request::prior_on(&grid, &believed)?;
        let reach_m = search.sigmas * prior.sigma_position_m;
        let square = MapSquare::around(grid.zone(), MapPoint::of(&prior.pose), search.extent_m, reach_m);
        let mut stored = BTreeMap::new();
        for id in square.tiles() {
            stored.extend(self.store.tile(id)?.map(|found| (id, found.tile)));
        }
        let weighed = |id: &TileId| Arc::new(TileWeights::packed(*id, |at| stored.get(&at).map(|t| &**t)));
        let tiles = stored.keys().map(weighed).collect();
        Ok(Case { square, tiles, batch, prior, search, integrity: self.config.locating.integrity() })
    }
}

/// The requests of a drive that engines and steps are timed on, evenly spread over it.
pub(super) fn timed_of(recording: &DriveQuestions) -> Vec<LocalizeRequest> {
    let indices = (0..recording.count()).step_by(recording.count().div_ceil(TIMED));
    indices.map(|index| recording.question(index).request.clone()).collect()
}

/// Number of detections of the median request.
pub(super) fn detections(requests: &[LocalizeRequest]) -> usize {
    let scans = |request: &LocalizeRequest| Some(request.batch.as_ref()?.scans.as_ref()?.range_m.len());
    let mut counts: Vec<_> = requests.iter().filter_map(scans).collect();
    counts.sort_unstable();
    counts.get(counts.len() / 2).copied().unwrap_or_default()
}

/// Milliseconds that some work takes, and its result.
pub(super) fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let from = Instant::now();
    let done = work();
    (from.elapsed().as_secs_f64() * 1e3, done)
}
