//! The time of the search by the size of window and batch: which engine is the fastest?

use std::collections::HashSet;

use anyhow::ensure;
use echofix_core::align::pipeline::Pipeline;
use echofix_core::align::{EngineKind, Search};
use echofix_core::batch::Batch;
use echofix_core::geo::CELL_M;
use echofix_core::point::BodyPoint;
use echofix_proto::v1::LocalizeRequest;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use serde::Serialize;

use super::BenchPlan;
use super::case::Case;
use super::inside::{InProcessService, timed};

/// Standard deviation of the distance from a detection to its copies along each axis, metres.
const SCATTER_M: f32 = 0.6;
/// Largest number of copies of a batch. No size needs so many: each adds fewer cells than the last.
const COPIES: usize = 200;

/// The time of the search in windows of one size, with batches of one size.
#[derive(Debug, Clone, Serialize)]
pub struct Size {
    /// Half width of the search, metres.
    pub half_width_m: f64,
    /// Occupied cells of the batches: the smallest number among them.
    pub cells: usize,
    /// Mean milliseconds of a search, by engine. Those of `fast` include the thinning of the batch.
    pub ms: Vec<(&'static str, f64)>,
}

/// Times the searches of some requests for every size of window and batch.
///
/// # Errors
/// When a request is malformed or the map cannot be read.
pub(super) fn measure(parts: &InProcessService, plan: &BenchPlan) -> anyhow::Result<Vec<Size>> {
    let mut sizes = Vec::new();
    for &half_width_m in &plan.half_widths_m {
        let requests = parts.requests().iter().take(plan.sized);
        let cases: Vec<_> =
            requests.map(|request| parts.case(&widened(request, half_width_m))).collect::<Result<_, _>>()?;
        for &cells in &plan.cells {
            sizes.push(size(&cases, half_width_m, cells, plan.seed)?);
        }
    }
    Ok(sizes)
}

/// The request with a prior whose search covers so many metres in each direction.
fn widened(request: &LocalizeRequest, half_width_m: f64) -> LocalizeRequest {
    let mut request = request.clone();
    if let Some(prior) = &mut request.prior {
        prior.sigma_position_m = half_width_m / Search::default().sigmas;
    }
    request
}

fn size(cases: &[Case], half_width_m: f64, cells: usize, seed: u64) -> anyhow::Result<Size> {
    let engines = [EngineKind::Fast, EngineKind::Bounded, EngineKind::Fft].map(EngineKind::engine);
    let mut ms = engines.map(|engine| (engine.name(), 0.0));
    let mut least = usize::MAX;
    let mut pipeline = Pipeline::default();
    for Case { square, tiles, batch, prior, search, .. } in cases {
        let (batch, occupied) = denser(batch, cells, search.extent_m as f32, seed)?;
        least = least.min(occupied);
        pipeline.assemble(*square, tiles);
        // The first search fills the buffers.
        pipeline.thin(&batch.points, search.extent_m);
        ms[0].1 += timed(|| pipeline.thin(&batch.points, search.extent_m)).0;
        for (engine, (_, ms)) in engines.into_iter().zip(&mut ms) {
            pipeline.search(engine, &batch, prior, search);
            *ms += timed(|| pipeline.search(engine, &batch, prior, search).len()).0;
        }
    }
    ensure!(!cases.is_empty(), "there is nothing to time");
    let mean = |(name, ms)| (name, ms / cases.len() as f64);
    Ok(Size { half_width_m, cells: least, ms: ms.map(mean).into() })
}

/// The batch with copies of its detections around them, so that it occupies about `cells` cells; and how many it occupies.
fn denser(batch: &Batch, cells: usize, reach_m: f32, seed: u64) -> anyhow::Result<(Batch, usize)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let scatter = Normal::new(0.0, SCATTER_M)?;
    let mut denser = batch.clone();
    let mut occupied: HashSet<_> = batch.points.iter().filter_map(|at| cell(*at, reach_m)).collect();
    for at in (0..COPIES).flat_map(|_| &batch.points) {
        if occupied.len() >= cells {
            break;
        }
        let mut copied = |at| at + scatter.sample(&mut rng);
        let copy = BodyPoint { x_m: copied(at.x_m), y_m: copied(at.y_m) };
        occupied.extend(cell(copy, reach_m));
        denser.points.push(copy);
    }
    Ok((denser, occupied.len()))
}

/// The cell of a point; `None` beyond reach.
fn cell(point: BodyPoint, reach_m: f32) -> Option<[i32; 2]> {
    let BodyPoint { x_m, y_m } = point;
    (x_m.hypot(y_m) <= reach_m).then(|| [x_m, y_m].map(|at| (f64::from(at) / CELL_M).floor() as i32))
}
