//! The alignment alone, by engine.

use std::hint::black_box;
use std::time::Instant;

use echofix_core::align::verdict::Integrity;
use echofix_core::align::{PreparedMap, Prior, Search, Workspace, align, fast_global_align};
use echofix_core::batch::Batch;
use serde::Serialize;

use crate::statistics::Percentiles;

/// A batch and the map around its prior.
pub(super) struct Case {
    pub(super) map: PreparedMap,
    pub(super) batch: Batch,
    pub(super) prior: Prior,
    pub(super) search: Search,
    pub(super) integrity: Integrity,
}

/// What an engine takes.
#[derive(Debug, Clone, Serialize)]
pub struct Engine {
    /// Its name.
    pub name: &'static str,
    /// Milliseconds a batch.
    pub ms: Percentiles,
    /// Its median over the first engine's.
    pub ratio: f64,
}

/// One alignment by an engine.
type Align = fn(&Case, &mut Workspace);

/// The engines; the first one is what the others are compared with.
const ENGINES: [(&str, Align); 2] = [
    ("`fast_global_align`: the paper's exhaustive search", |case, workspace| {
        black_box(fast_global_align(&case.map, &case.batch, &case.prior, &case.search, workspace));
    }),
    ("`align`: search, refinement, verdict", |case, workspace| {
        black_box(align(&case.map, &case.batch, &case.prior, &case.search, &case.integrity, workspace));
    }),
];

/// Times every engine on every case, so many times.
pub(super) fn measure(cases: &[Case], repetitions: usize) -> Vec<Engine> {
    let mut measured: Vec<Engine> = Vec::new();
    for (name, align) in ENGINES {
        let mut workspace = Workspace::default();
        let mut times = Vec::new();
        for case in cases {
            // The first time fills buffers.
            align(case, &mut workspace);
            times.extend((0..repetitions).map(|_| {
                let from = Instant::now();
                align(case, &mut workspace);
                from.elapsed().as_secs_f64() * 1e3
            }));
        }
        if let Some(ms) = Percentiles::of(times) {
            let ratio = measured.first().map_or(1.0, |first| ms.p50 / first.ms.p50);
            measured.push(Engine { name, ms, ratio });
        }
    }
    measured
}
