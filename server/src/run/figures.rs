//! Figures that are looked up when somebody reads the metrics.

use std::fs;
use std::path::Path;
use std::sync::{Arc, Weak};
use std::time::UNIX_EPOCH;

use prometheus_client::metrics::gauge::Gauge;

use super::ServiceContext;
use crate::http::LAST_BACKUP;
use crate::locating::Locator;
use crate::metrics::{Figures, Metrics};
use crate::store::{self, MapStore, Operations};

/// Has the metrics look up what the store and the disk know. It does not keep the store open.
pub(super) fn of_store(shared: &ServiceContext) {
    let (operations, store) = (Arc::downgrade(&shared.operations), Arc::downgrade(&shared.store));
    let dir = shared.config.store.directory();
    shared.metrics.look_up(move |figures| {
        of_map(&operations, &store, figures);
        of_disk(&dir, figures);
    });
}

fn of_map(operations: &Weak<dyn Operations>, store: &Weak<dyn MapStore>, figures: &Figures) {
    if let Some(store) = store.upgrade() {
        set(&figures.waiting_tiles, store.totals().waiting_tiles);
    }
    let Some(operations) = operations.upgrade() else { return };
    let folding = operations.folding();
    let bits = folding.spent.as_secs_f64().to_bits();
    figures.fold_seconds.inner().store(bits, std::sync::atomic::Ordering::Relaxed);
    for (outcome, total) in [
        ("AGREES", folding.agree),
        ("NEW", folding.new),
        ("NOT_VETTED", folding.not_vetted),
        ("QUARANTINED", folding.quarantined),
    ] {
        figures.vetted.set(outcome, total);
    }
}

/// What cannot be read stays as it was.
fn of_disk(dir: &Path, figures: &Figures) {
    if let Ok(free) = store::free_bytes(dir) {
        set(&figures.disk_free_bytes, free);
    }
    if let Ok(bytes) = store::journal_bytes(dir) {
        set(&figures.journal_bytes, bytes);
    }
    let taken = fs::metadata(dir.join(LAST_BACKUP)).and_then(|note| note.modified());
    let since = taken.ok().and_then(|taken| taken.duration_since(UNIX_EPOCH).ok());
    set(&figures.backup_s, since.map_or(0, |since| since.as_secs()));
}

/// Has the metrics look up what the cache of prepared tiles holds.
pub(super) fn of_cache(metrics: &Metrics, locator: &Arc<Locator>) {
    let locator = Arc::downgrade(locator);
    metrics.look_up(move |figures| {
        let Some(locator) = locator.upgrade() else { return };
        let cache = locator.cache();
        set(&figures.tile_cache_bytes, cache.bytes);
        figures.tile_cache.set("hit", cache.hits);
        figures.tile_cache.set("miss", cache.misses);
    });
}

fn set(gauge: &Gauge, value: u64) {
    gauge.set(i64::try_from(value).unwrap_or(i64::MAX));
}
