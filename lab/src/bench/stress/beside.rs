//! The same questions alone, and beside uploads, folding, vetting, rendering and verifying.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use echofix_client::upload::{RecorderConfig, UploadForm};
use echofix_harness::percentiles::Percentiles;
use echofix_harness::process::ServiceProcess;
use echofix_harness::recording::{record, to_the_ends};
use echofix_harness::replay::patient_localizer;
use echofix_harness::town;
use echofix_proto::v1::UploadRequest;
use echofix_proto::v1::mapping_service_client::MappingServiceClient;
use echofix_proto::v1::upload_request::Part;
use echofix_sim::{City, CityParams, Route};
use serde::Serialize;
use tonic::transport::Endpoint;
use uuid::Uuid;

use super::super::BenchPlan;
use super::super::town::BenchTown;
use super::Subject;

/// Vehicles that upload without pause.
const UPLOADERS: u64 = 16;
/// Between two questions of the one vehicle that asks.
const EVERY: Duration = Duration::from_millis(20);
/// By how much the disturbing clients are nicer than the service.
const NICER: i32 = 15;

/// What the disturbance consisted of, and what it did.
#[derive(Debug, Clone, Serialize)]
pub(in super::super) struct Beside {
    /// Milliseconds from a question to its answer, alone.
    pub(in super::super) alone_ms: Percentiles,
    /// The same beside all else.
    pub(in super::super) disturbed_ms: Percentiles,
    /// Uploads acknowledged, pictures drawn and verifications done in that time, and its length, seconds.
    pub(in super::super) uploads: u64,
    pub(in super::super) pictures: u64,
    pub(in super::super) verified: u64,
    pub(in super::super) seconds: f64,
}

/// What the disturbers did.
#[derive(Default)]
struct Done {
    over: AtomicBool,
    uploads: AtomicU64,
    pictures: AtomicU64,
    verified: AtomicU64,
}

impl Done {
    fn goes_on(&self) -> bool {
        !self.over.load(Ordering::Relaxed)
    }
}

pub(super) async fn measure(
    plan: &BenchPlan,
    subject: &Subject<'_>,
    town: &BenchTown,
) -> anyhow::Result<Beside> {
    let templates = Arc::new(uploads(plan)?);
    let service = subject.start().await?;
    let span = Duration::from_secs_f64(plan.load_s);
    asked(&service, town, Duration::from_secs(2)).await?;
    let alone_ms = asked(&service, town, span).await?;
    let done = Arc::new(Done::default());
    let (grpc, http, seed) = (service.grpc.clone(), service.http.clone(), plan.seed);
    let (shared, began) = (Arc::clone(&done), Instant::now());
    let disturbing = std::thread::spawn(move || disturb((grpc, http), seed, &templates, &shared));
    // Until all of it is under way.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let disturbed_ms = asked(&service, town, span).await;
    let seconds = began.elapsed().as_secs_f64();
    done.over.store(true, Ordering::Relaxed);
    let count = |of: &AtomicU64| of.load(Ordering::Relaxed);
    let (uploads, pictures, verified) = (count(&done.uploads), count(&done.pictures), count(&done.verified));
    let joined = tokio::task::spawn_blocking(move || disturbing.join()).await?;
    joined.map_err(|_| anyhow::anyhow!("what was to disturb the service broke down"))??;
    service.stop().await?;
    Ok(Beside { alone_ms, disturbed_ms: disturbed_ms?, uploads, pictures, verified, seconds })
}

/// Milliseconds of one vehicle's questions, one after the other.
async fn asked(service: &ServiceProcess, town: &BenchTown, span: Duration) -> anyhow::Result<Percentiles> {
    let localizer = patient_localizer(&service.grpc)?;
    let (began, mut index, mut times_ms) = (Instant::now(), 0, Vec::new());
    while began.elapsed() < span {
        let from = Instant::now();
        localizer.ask(town.recording.question(index % town.recording.count())).await?;
        times_ms.push(from.elapsed().as_secs_f64() * 1e3);
        index += 1;
        tokio::time::sleep(EVERY).await;
    }
    Percentiles::of(times_ms).context("nothing was asked")
}

/// Raw uploads of drives in the same town, which the service has to build evidence from.
fn uploads(plan: &BenchPlan) -> anyhow::Result<Vec<Vec<UploadRequest>>> {
    let (blocks_x, blocks_y) = plan.blocks;
    let params = CityParams { seed: plan.seed, blocks_x, blocks_y, ..CityParams::default() };
    let city = City::generate(&params)?;
    let seed = plan.seed * 1000 + 500;
    let drive = town::drive(&city, 1, &Route::survey(&city, seed), "beside".to_owned(), seed)?;
    let config = RecorderConfig { form: UploadForm::Scans, ..to_the_ends() };
    let recorded = record(&drive, config)?;
    Ok(recorded.uploads.into_iter().map(echofix_client::upload::PreparedUpload::into_parts).collect())
}

/// Uploads, looks and verifies until it is over, on threads that yield to the service's.
fn disturb(
    (grpc, http): (String, String),
    seed: u64,
    templates: &[Vec<UploadRequest>],
    done: &Arc<Done>,
) -> anyhow::Result<()> {
    std::thread::scope(|threads| {
        for picture in [true, false] {
            let (http, done) = (http.clone(), Arc::clone(done));
            threads.spawn(move || {
                echofix_server::lanes::lower(NICER);
                while done.goes_on() {
                    if picture { look(&http, &done) } else { verify(&http, &done) }
                }
            });
        }
        echofix_server::lanes::lower(NICER);
        tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(async {
            let one = |number| upload_on(&grpc, seed, number, templates, done);
            futures_all((0..UPLOADERS).map(one)).await
        })
    })
}

async fn futures_all(
    uploading: impl Iterator<Item = impl Future<Output = anyhow::Result<()>>>,
) -> anyhow::Result<()> {
    let mut waiting: Vec<_> = uploading.map(Box::pin).collect();
    std::future::poll_fn(move |context| {
        let mut at = 0;
        while at < waiting.len() {
            match waiting[at].as_mut().poll(context) {
                std::task::Poll::Pending => at += 1,
                std::task::Poll::Ready(Ok(())) => drop(waiting.swap_remove(at)),
                failed @ std::task::Poll::Ready(Err(_)) => return failed,
            }
        }
        if waiting.is_empty() { std::task::Poll::Ready(Ok(())) } else { std::task::Poll::Pending }
    })
    .await
}

/// One vehicle: upload after upload, each of another contributor.
async fn upload_on(
    grpc: &str,
    seed: u64,
    number: u64,
    templates: &[Vec<UploadRequest>],
    done: &Done,
) -> anyhow::Result<()> {
    let mut client = MappingServiceClient::new(Endpoint::from_shared(grpc.to_owned())?.connect().await?);
    let mut sent = number;
    while done.goes_on() {
        let mut parts = templates[sent as usize % templates.len()].clone();
        if let Some(Part::Header(header)) = parts.first_mut().and_then(|first| first.part.as_mut()) {
            header.upload_id = Uuid::from_u64_pair(seed, sent).to_string();
            header.contributor = format!("beside-{sent}");
        }
        if client.upload(tokio_stream::iter(parts)).await.is_ok() {
            done.uploads.fetch_add(1, Ordering::Relaxed);
        } else {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        sent += UPLOADERS;
    }
    Ok(())
}

/// Draws the whole map, and its tile.
fn look(http: &str, done: &Done) {
    let agent =
        ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(10))).build().new_agent();
    let drawn = agent.get(format!("{http}/tiles/evidence/12/936/1688@2x.png")).call();
    if drawn.is_ok() {
        done.pictures.fetch_add(1, Ordering::Relaxed);
    }
}

fn verify(http: &str, done: &Done) {
    let agent =
        ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(5))).build().new_agent();
    if agent.post(format!("{http}/api/v1/map/verify?replay=true")).send_empty().is_ok() {
        done.verified.fetch_add(1, Ordering::Relaxed);
    }
}
