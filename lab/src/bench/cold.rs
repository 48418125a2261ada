//! A street for which the service has prepared no tiles yet: what the map windows and their memory cost.

use std::path::Path;

use serde::Serialize;

use super::load::once;
use super::town::{BenchTown, TRUSTING};
use crate::machine::{held_by, used_by};
use echofix_harness::percentiles::Percentiles;
use echofix_harness::process::ServiceProcess;

/// A cache with room for all tiles of the street.
pub(super) const ROOM: &str = "locating.tile_cache_mib=8192";

/// No sampled checks: the images of their engine would count as memory of the street.
const UNCONFIRMED: &str = "locating.confirm_share=0.0";

/// What the first requests in a street cost.
#[derive(Debug, Clone, Serialize)]
pub struct Cold {
    /// Number of requests.
    pub asked: usize,
    /// Kilometres of street along which they were sent.
    pub street_km: f64,
    /// Milliseconds for the map window of a request, with an empty cache at the start.
    pub window_ms: Option<Percentiles>,
    /// Milliseconds for the map window of the same requests, when all tiles are cached.
    pub cached_ms: Option<Percentiles>,
    /// Milliseconds of the service's processor time that a kilometre costs, beyond what the same requests cost when all
    /// tiles are cached.
    pub cpu_ms_per_km: Option<f64>,
    /// Megabytes by which the service's memory grows in a kilometre.
    pub memory_mb_per_km: Option<f64>,
}

/// Sends the requests along a street twice, to a service that has just started.
///
/// # Errors
/// When the service does not start or does not answer.
pub(super) async fn measure(town: &BenchTown, folder: &Path) -> anyhow::Result<Cold> {
    let settings = ["locating.threads=1", ROOM, TRUSTING, UNCONFIRMED].map(str::to_owned);
    let service = ServiceProcess::start(folder, &settings).await?;
    let used = || used_by(service.pid()).map(|used| used.as_secs_f64() * 1e3);
    let held = || held_by(service.pid()).map(|kibibytes| kibibytes as f64 * 1024e-6);
    let (used_0, held_0) = (used(), held());
    let first = once(&service, &town.recording).await?;
    let (used_1, held_1) = (used(), held());
    let second = once(&service, &town.recording).await?;
    let used_2 = used();
    service.stop().await?;
    let street_km = town.asked_over_m / 1e3;
    let windows = |answers: &[super::load::Answered]| {
        let answered = answers.iter().filter_map(|(_, answer, _)| answer.as_ref().ok()?.diagnostics);
        Percentiles::of(answered.map(|diagnostics| diagnostics.window_ms))
    };
    let cpu_ms = || Some((used_1? - used_0?) - (used_2? - used_1?));
    Ok(Cold {
        asked: first.len(),
        street_km,
        window_ms: windows(&first),
        cached_ms: windows(&second),
        cpu_ms_per_km: cpu_ms().map(|ms| ms / street_km),
        memory_mb_per_km: held_1.zip(held_0).map(|(after, before)| (after - before) / street_km),
    })
}
