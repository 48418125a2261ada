//! Every hypothesis, by the FFT.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Candidate, Engine, EngineWorkspace, SearchQuestion};
use crate::align::correlation::Correlation;
use crate::align::fft::Plans;
use crate::align::image::MapImage;
use crate::align::projection::DistinctPixels;
use crate::align::simd::Isa;
use crate::align::view::WindowTiles;
use crate::align::{CorrelationWorkspace, fast_global_align};

/// Largest error of a value of the correlation, as a fraction of the product of the images' norms.
/// Single precision rounds by 6e-8 at each of some twenty steps of butterflies; the test holds it to this.
const RELATIVE_ERROR: f32 = 2e-6;

/// The engine; see [`fast_global_align`], which it calls.
#[derive(Debug, Clone, Copy, Default)]
pub struct Fft;

/// Plans, the spectrum of the last map, and buffers.
#[derive(Default)]
struct FftBuffers {
    plans: BTreeMap<usize, Arc<Plans>>,
    map: Option<(WindowTiles, MapImage)>,
    correlation: CorrelationWorkspace,
    distinct: DistinctPixels,
    occupied: Vec<u32>,
}

impl Engine for Fft {
    fn name(&self) -> &'static str {
        "fft"
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        let buffers = workspace.buffers::<FftBuffers>();
        for (question, candidates) in questions.iter().zip(candidates) {
            buffers.search(question, candidates);
        }
    }
}

impl FftBuffers {
    fn search(&mut self, question: &SearchQuestion, candidates: &mut Vec<Candidate>) {
        candidates.clear();
        self.transform(question);
        let Some((_, map)) = &self.map else { return };
        let SearchQuestion { batch, prior, search, lattice, .. } = question;
        let (_, correlation) = fast_global_align(map, batch, prior, search, &mut self.correlation);
        let norms = map.norm() * (batch.points.len() as f32).sqrt();
        question.occupied(Isa::best(), lattice.turns, &mut self.distinct, &mut self.occupied);
        let cells = self.occupied.len();
        let (best, sum) = self.certain(question, &correlation, RELATIVE_ERROR * norms);
        candidates.push(question.candidate(best, sum, cells));
        let first = lattice.hypothesis(best);
        for index in correlation.highest(search.candidates, search.separation_m) {
            let distinct = lattice.hypothesis(index).distance_m(&first) >= search.separation_m;
            if distinct && candidates.len() < search.candidates {
                candidates.push(question.candidate(index, correlation.values[index].round() as u32, cells));
            }
        }
    }

    /// The map's spectrum, unless it is that of the last question.
    fn transform(&mut self, question: &SearchQuestion) {
        let window @ WindowTiles { square, tiles } = question.view.window();
        if self.map.as_ref().is_some_and(|(of, _)| of.same_tiles(*square, tiles)) {
            return;
        }
        let plans = self.plans.entry(square.side).or_insert_with(|| Arc::new(Plans::new(square.side)));
        let image = MapImage::of_weights(&question.view.fine(), Arc::clone(plans));
        self.map = Some((window.clone(), image));
    }

    /// The maximum beyond rounding: what comes within the error of the highest value is summed up
    /// anew in integers.
    fn certain(&mut self, question: &SearchQuestion, correlation: &Correlation, error: f32) -> (usize, u32) {
        let lattice = question.lattice;
        let high = correlation.values.iter().fold(f32::MIN, |a, b| a.max(*b)) - 2.0 * error;
        let (mut best, mut drawn) = ((0, 0), usize::MAX);
        for (index, _) in correlation.values.iter().enumerate().filter(|(_, value)| **value >= high) {
            let heading = index / lattice.plane();
            if heading != drawn {
                question.occupied(Isa::best(), heading, &mut self.distinct, &mut self.occupied);
                drawn = heading;
            }
            let (row, column) = (index % lattice.plane() / lattice.width(), index % lattice.width());
            let sum = question.sum(&self.occupied, row, column);
            if sum > best.1 {
                best = (index, sum);
            }
        }
        best
    }
}
