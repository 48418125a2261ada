//! The alignment alone, by engine.

use std::hint::black_box;

use anyhow::ensure;
use echofix_core::align::engine::{self, Bounded, Fast, Fft, Reference};
use echofix_core::align::view::MapView;
use echofix_core::align::{Aligner, EngineKind, Task, thin};
use serde::Serialize;

use super::case::Case;
use super::inside::timed;
use echofix_harness::percentiles::Percentiles;

/// What an engine takes.
#[derive(Debug, Clone, Serialize)]
pub struct Engine {
    /// Its name.
    pub name: String,
    /// Milliseconds a batch.
    pub ms: Percentiles,
    /// Its median over the first engine's.
    pub ratio: f64,
    /// Cases with the first engine's maximum, of all.
    pub identical: Option<(usize, usize)>,
}

/// Engines that must find the reference's maximum.
const EXACT: [&str; 2] = ["fft", "bounded"];

/// Times every engine on every case, so many times; the slow ones once.
///
/// # Errors
/// When an exact engine finds another maximum than the reference.
pub(super) fn measure(cases: &[Case], repetitions: usize) -> anyhow::Result<Vec<Engine>> {
    let engines: [(Box<dyn engine::Engine>, usize); 5] = [
        (Box::new(Reference::default()), 1),
        (Box::new(Reference::as_printed()), 1),
        (Box::new(Fft::default()), 1 + repetitions / 10),
        (Box::new(Bounded::default()), repetitions),
        (Box::new(Fast::default()), repetitions),
    ];
    let mut measured: Vec<Engine> = Vec::new();
    let mut maxima = Vec::new();
    for (mut engine, repetitions) in engines {
        let (times, found) = search(cases, &mut *engine, repetitions);
        if maxima.is_empty() {
            maxima.clone_from(&found);
        }
        let same = maxima.iter().zip(&found).filter(|(a, b)| a == b).count();
        // Coarse to fine counts thinned points: its maximum is not that of the same sum.
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

fn push(measured: &mut Vec<Engine>, name: String, times: Vec<f64>, identical: Option<(usize, usize)>) {
    if let Some(ms) = Percentiles::of(times) {
        let ratio = measured.first().map_or(1.0, |first: &Engine| ms.p50 / first.ms.p50);
        measured.push(Engine { name, ms, ratio, identical });
    }
}

/// Milliseconds of the search alone, and the maximum of each case.
fn search(
    cases: &[Case],
    engine: &mut dyn engine::Engine,
    repetitions: usize,
) -> (Vec<f64>, Vec<echofix_core::pose::Pose2>) {
    let (mut times, mut maxima, mut peaks) = (Vec::new(), Vec::new(), Vec::new());
    let (mut view, mut thinned) = (MapView::default(), Vec::new());
    for case in cases {
        view.show(case.frame, &case.tiles);
        let reach_m = case.search.extent_m as f32;
        thin::Thinner::default().thin(&case.batch.points, reach_m, thin::BLOCK_M, &mut thinned);
        let question = case.question(&view, &case.batch, &thinned);
        // The first time fills buffers.
        engine.search(&question, &mut peaks);
        times.extend((0..repetitions).map(|_| timed(|| engine.search(&question, &mut peaks)).0));
        maxima.extend(peaks.first().map(|peak| peak.correction));
    }
    (times, maxima)
}

/// Milliseconds of search, climb and verdict.
fn whole(cases: &[Case], kind: EngineKind, repetitions: usize) -> Vec<f64> {
    let mut aligner = Aligner::default();
    let mut times = Vec::new();
    for Case { frame, tiles, batch, prior, search, integrity } in cases {
        let task = Task { frame: *frame, tiles, batch, prior };
        let mut fix = || {
            black_box(aligner.align(&task, kind, search, integrity));
        };
        fix();
        times.extend((0..repetitions).map(|_| timed(&mut fix).0));
    }
    times
}
