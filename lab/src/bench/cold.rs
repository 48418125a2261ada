//! A street that the service has not seen yet: windows made, memory taken.

use std::path::Path;

use serde::Serialize;

use super::load::once;
use super::town::{BenchTown, TRUSTING};
use crate::machine::{held_by, used_by};
use echofix_harness::percentiles::Percentiles;
use echofix_harness::process::ServiceProcess;

/// Room for all windows of the street.
pub(super) const ROOM: &str = "locating.tile_cache_mib=8192";

/// No answer is asked again of another engine, whose images would count as the street's.
const UNCONFIRMED: &str = "locating.confirm_share=0.0";

/// What it costs to come to a street.
#[derive(Debug, Clone, Serialize)]
pub struct Cold {
    /// Questions.
    pub asked: usize,
    /// Kilometres of street they were asked over.
    pub street_km: f64,
    /// Milliseconds for the window of a question, cached or not.
    pub window_ms: Option<Percentiles>,
    /// Milliseconds for it when all windows are cached.
    pub cached_ms: Option<Percentiles>,
    /// Milliseconds of the service's processor time that a kilometre cost, beyond what the same
    /// questions cost once the windows are cached.
    pub cpu_ms_per_km: Option<f64>,
    /// Megabytes of memory the service holds after a kilometre.
    pub memory_mb_per_km: Option<f64>,
}

/// Asks along a street twice, on a service that has just started.
///
/// # Errors
/// When the service does not come up or answer.
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
