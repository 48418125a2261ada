//! The time of the search and of a whole fix, engine by engine.

use std::hint::black_box;

use anyhow::ensure;
use echofix_core::align::engine::{self, Bounded, Fast, Fft, Reference};
use echofix_core::align::pipeline::Pipeline;
use echofix_core::align::{Aligner, EngineKind, Task};
use serde::Serialize;

use super::case::Case;
use super::inside::timed;
use echofix_harness::percentiles::Percentiles;

/// The time that an engine takes.
#[derive(Debug, Clone, Serialize)]
pub struct EngineTiming {
    /// Name of the engine, or of the whole fix with it.
    pub name: String,
    /// Milliseconds for a batch.
    pub ms: Percentiles,
    /// Its median divided by that of the first engine.
    pub ratio: f64,
    /// In how many cases it found the first engine's maximum, and how many cases there are; absent where its sums are others.
    pub identical: Option<(usize, usize)>,
}

/// Exact engines, which must find the maximum of the reference.
const EXACT: [&str; 2] = ["fft", "bounded"];

/// Times every engine on every case, `repetitions` times; the slow engines fewer times.
///
/// # Errors
/// When an exact engine finds another maximum than the reference.
pub(super) fn measure(cases: &[Case], repetitions: usize) -> anyhow::Result<Vec<EngineTiming>> {
    let engines: [(Box<dyn engine::Engine>, usize); 5] = [
        (Box::new(Reference::default()), 1),
        (Box::new(Reference::as_printed()), 1),
        (Box::new(Fft), 1 + repetitions / 10),
        (Box::new(Bounded::default()), repetitions),
        (Box::new(Fast::default()), repetitions),
    ];
    let mut measured: Vec<EngineTiming> = Vec::new();
    let mut maxima = Vec::new();
    for (engine, repetitions) in engines {
        let (times, found) = search(cases, &*engine, repetitions);
        if maxima.is_empty() {
            maxima.clone_from(&found);
        }
        let same = maxima.iter().zip(&found).filter(|(a, b)| a == b).count();
        // `fast` sums over thinned points, so that its maximum is that of another sum.
        let identical = (engine.name() != "fast").then_some((same, cases.len()));
        let exact = !EXACT.contains(&engine.name()) || same == cases.len();
        ensure!(
            exact,
            "{} found the reference's maximum in {same} of {} cases only",
            engine.name(),
            cases.len()
        );
        push(&mut measured, engine.name().to_owned(), times, identical);
    }
    for (name, kind) in [("whole fix, fast", EngineKind::Fast), ("whole fix, bounded", EngineKind::Bounded)] {
        push(&mut measured, name.to_owned(), whole(cases, kind, repetitions), None);
    }
    Ok(measured)
}

fn push(measured: &mut Vec<EngineTiming>, name: String, times: Vec<f64>, identical: Option<(usize, usize)>) {
    if let Some(ms) = Percentiles::of(times) {
        let ratio = measured.first().map_or(1.0, |first: &EngineTiming| ms.p50 / first.ms.p50);
        measured.push(EngineTiming { name, ms, ratio, identical });
    }
}

/// Milliseconds of the search alone, and the correction at the maximum of each case.
fn search(
    cases: &[Case],
    engine: &dyn engine::Engine,
    repetitions: usize,
) -> (Vec<f64>, Vec<echofix_core::pose::Pose2>) {
    let (mut times, mut maxima) = (Vec::new(), Vec::new());
    let mut pipeline = Pipeline::default();
    for Case { square, tiles, batch, prior, search, .. } in cases {
        pipeline.assemble(*square, tiles);
        pipeline.thin(&batch.points, search.extent_m);
        // The first search fills the buffers.
        let found = pipeline.search(engine, batch, prior, search);
        maxima.extend(found.first().map(|top| top.correction));
        let mut search = || pipeline.search(engine, batch, prior, search).len();
        times.extend((0..repetitions).map(|_| timed(&mut search).0));
    }
    (times, maxima)
}

/// Milliseconds of whole fixes: search, refinement and verdict.
fn whole(cases: &[Case], kind: EngineKind, repetitions: usize) -> Vec<f64> {
    let mut aligner = Aligner::default();
    let mut times = Vec::new();
    for Case { square, tiles, batch, prior, search, integrity } in cases {
        let task = Task { square: *square, tiles, batch, prior };
        let mut fix = || {
            black_box(aligner.align(&task, kind.engine(), search, integrity));
        };
        fix();
        times.extend((0..repetitions).map(|_| timed(&mut fix).0));
    }
    times
}
