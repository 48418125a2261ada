//! A street for which the service has prepared no tiles yet: what the map windows and their memory cost.

use std::ops::Range;
use std::path::Path;

use serde::Serialize;

use super::load::{once, within};
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
    /// The service's memory over the kilometres of street that it has been asked along, megabytes.
    pub memory: Option<MemoryLine>,
}

/// What a process takes once, and what each kilometre adds: a line through what was measured along the way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MemoryLine {
    /// Megabytes before the first kilometre.
    pub once_mb: f64,
    /// Megabytes a kilometre.
    pub mb_per_km: f64,
}

impl MemoryLine {
    /// The line of least squares through (kilometres, megabytes); `None` without two different kilometres.
    fn through(points: &[(f64, f64)]) -> Option<Self> {
        let count = points.len() as f64;
        let mean = |of: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
        let (km, mb) = (mean(&|point| point.0), mean(&|point| point.1));
        let spread = points.iter().map(|point| (point.0 - km).powi(2)).sum::<f64>();
        let common = points.iter().map(|point| (point.0 - km) * (point.1 - mb)).sum::<f64>();
        (spread > 0.0).then(|| Self { mb_per_km: common / spread, once_mb: mb - common / spread * km })
    }
}

/// Parts of the street after each of which the memory is looked at.
const PARTS: usize = 8;

/// Sends the requests along a street twice, to a service that has just started.
///
/// # Errors
/// When the service does not start or does not answer.
pub(super) async fn measure(town: &BenchTown, folder: &Path) -> anyhow::Result<Cold> {
    let settings = ["locating.threads=1", ROOM, TRUSTING, UNCONFIRMED].map(str::to_owned);
    let service = ServiceProcess::start(folder, &settings).await?;
    let used = || used_by(service.pid()).map(|used| used.as_secs_f64() * 1e3);
    let held = || held_by(service.pid()).map(|kibibytes| kibibytes as f64 * 1024e-6);
    let used_0 = used();
    let (mut first, mut memory) = (Vec::new(), Vec::new());
    let street_km = town.asked_over_m / 1e3;
    for part in parts(town.recording.count()) {
        first.extend(within(&service, &town.recording, part.clone()).await?);
        let asked = part.end as f64 / town.recording.count() as f64;
        memory.extend(held().map(|held| (asked * street_km, held)));
    }
    let used_1 = used();
    let second = once(&service, &town.recording).await?;
    let used_2 = used();
    service.stop().await?;
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
        memory: MemoryLine::through(&memory),
    })
}

/// So many numbers in parts, one after the other.
fn parts(count: usize) -> impl Iterator<Item = Range<usize>> {
    (0..PARTS).map(move |part| part * count / PARTS..(part + 1) * count / PARTS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_what_is_there_once_and_what_each_kilometre_adds() {
        let line = MemoryLine::through(&[(0.5, 33.0), (1.0, 34.0), (2.0, 36.0)]).unwrap();
        assert!((line.once_mb - 32.0).abs() < 1e-9 && (line.mb_per_km - 2.0).abs() < 1e-9);
        assert_eq!(MemoryLine::through(&[(1.0, 33.0), (1.0, 34.0)]), None);
        assert_eq!(parts(20).map(|part| part.len()).sum::<usize>(), 20);
    }
}
