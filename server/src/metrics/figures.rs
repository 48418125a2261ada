//! Figures that are looked up when somebody reads the metrics.

use std::sync::atomic::{AtomicU64, Ordering};

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Registry, Unit};

use super::OutcomeLabel;

/// What others count, by outcome.
#[derive(Debug, Clone, Default)]
pub struct Outcomes(Family<OutcomeLabel, Counter>);

impl Outcomes {
    /// So many so far.
    pub fn set(&self, outcome: &'static str, total: u64) {
        self.0.get_or_create(&OutcomeLabel { outcome }).inner().store(total, Ordering::Relaxed);
    }
}

/// Figures that are looked up when somebody reads the metrics.
#[derive(Debug, Clone, Default)]
pub struct Figures {
    /// Free bytes where the data directory lies.
    pub disk_free_bytes: Gauge,
    /// Bytes of the journal's segments.
    pub journal_bytes: Gauge,
    /// Bytes of prepared tiles in memory.
    pub tile_cache_bytes: Gauge,
    /// Prepared tiles asked for, by whether they were there.
    pub tile_cache: Outcomes,
    /// Seconds spent folding.
    pub fold_seconds: Counter<f64, AtomicU64>,
    /// Uploads that vetting has decided on since the start, by outcome.
    pub vetted: Outcomes,
    /// Tiles of which nothing is served yet.
    pub waiting_tiles: Gauge,
    /// Seconds from the Unix epoch to when the last backup was taken; 0 without one.
    pub backup_s: Gauge,
}

impl Figures {
    pub(super) fn register(&self, r: &mut Registry) {
        let mut bytes =
            |name, help, gauge: &Gauge| r.register_with_unit(name, help, Unit::Bytes, gauge.clone());
        bytes("disk_free", "Free room where the data directory lies", &self.disk_free_bytes);
        bytes("journal", "Size of the journal's segments", &self.journal_bytes);
        bytes("tile_cache", "Memory that prepared tiles take", &self.tile_cache_bytes);
        let help = "Prepared tiles asked for, by whether they were in memory";
        r.register("tile_cache_lookups", help, self.tile_cache.0.clone());
        r.register_with_unit("fold", "Time spent folding", Unit::Seconds, self.fold_seconds.clone());
        let help = "Uploads that vetting has decided on since the start, by outcome";
        r.register("vetted_uploads", help, self.vetted.0.clone());
        let help = "Tiles not served yet, because too few contributors have seen the same there";
        r.register("waiting_tiles", help, self.waiting_tiles.clone());
        let help = "When the last backup was taken, seconds since the Unix epoch; 0 without one";
        r.register("last_backup_timestamp_seconds", help, self.backup_s.clone());
    }
}
