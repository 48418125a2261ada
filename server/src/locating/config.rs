//! How to locate.

use echofix_core::align::verdict::Integrity;
use echofix_core::align::{EngineKind, Search};
use echofix_core::gate::Gate;
use serde::{Deserialize, Serialize};

/// Ways to find the maximum of the correlation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum EngineChoice {
    /// The fastest for the request.
    #[serde(rename = "auto")]
    Auto,
    /// Coarse to fine.
    #[serde(rename = "fast")]
    Fast,
    /// Exact, by bounds.
    #[serde(rename = "bounded")]
    Bounded,
    /// Exact, every hypothesis.
    #[serde(rename = "fft")]
    Fft,
}

impl From<EngineChoice> for EngineKind {
    fn from(engine: EngineChoice) -> Self {
        match engine {
            // Coarse to fine is the fastest at every width and batch measured: docs/benchmarks/service.md.
            EngineChoice::Auto | EngineChoice::Fast => Self::Fast,
            EngineChoice::Bounded => Self::Bounded,
            EngineChoice::Fft => Self::Fft,
        }
    }
}

/// The `[locating]` section; `echofix.toml` documents each key.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LocatingConfig {
    /// Alignments that run at once; 0 for one a core.
    pub threads: usize,
    /// Requests that may wait for one of them.
    pub queue: usize,
    /// Memory for prepared tiles, MiB.
    pub tile_cache_mib: u64,
    /// Memory for the batches that are kept for streams, MiB; 0 keeps none.
    pub stream_batches_mib: u64,
    /// Which engine finds the maximum of the correlation.
    pub engine: EngineChoice,
    /// Fraction of the answers that are repeated with an exact engine: the sampled check.
    pub confirm_share: f64,
    /// Half width of the relocalization, metres; 0 for none.
    pub wide_search_m: f64,
    /// Slower vehicles are refused, metres per second.
    pub min_speed_mps: f64,
    /// Detections farther away are dropped, metres; in the file 0 for that of `[radar]`.
    pub max_range_m: f64,
    /// Detections whose radial speed differs more from a stationary target's are dropped, metres
    /// per second.
    pub max_doppler_residual_mps: f64,
    /// Batches with fewer detections after the gates are refused.
    pub min_detections: usize,
    /// The largest prior sigma of the position, metres.
    pub max_sigma_position_m: f64,
    /// The largest prior sigma of the heading, degrees.
    pub max_sigma_yaw_deg: f64,
    /// The integrity risk when the request names none.
    pub integrity_risk: f64,
}

impl LocatingConfig {
    /// Which detections a batch is made of.
    #[must_use]
    pub fn gate(&self) -> Gate {
        Gate {
            min_speed_mps: self.min_speed_mps,
            max_range_m: self.max_range_m,
            max_doppler_residual_mps: self.max_doppler_residual_mps,
            ..Gate::default()
        }
    }

    /// How to search: the paper's steps within the configured reach.
    #[must_use]
    pub fn search(&self) -> Search {
        Search { extent_m: self.max_range_m, ..Search::default() }
    }

    /// What an answer must pass.
    #[must_use]
    pub fn integrity(&self) -> Integrity {
        Integrity::default()
    }

    /// Alignments that run at once.
    #[must_use]
    pub fn threads(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            n => n,
        }
    }
}
