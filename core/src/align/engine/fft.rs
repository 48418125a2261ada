//! Every hypothesis, by the FFT.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Engine, Peak, Question};
use crate::align::cells::Once;
use crate::align::correlation::Correlation;
use crate::align::fft::Plans;
use crate::align::image::MapImage;
use crate::align::simd::Isa;
use crate::align::view::Square;
use crate::align::{Workspace, fast_global_align};

/// Largest error of a value of the correlation, as a share of the product of the images' norms.
/// Single precision keeps 6e-8 at each of some twenty steps of butterflies; the test holds it to this.
const RELATIVE_ERROR: f32 = 2e-6;

/// The engine, its plans, and the spectrum of the last map.
#[derive(Default)]
pub struct Fft {
    plans: BTreeMap<usize, Arc<Plans>>,
    map: Option<(Square, MapImage)>,
    workspace: Workspace,
    once: Once,
    occupied: Vec<u32>,
}

impl Engine for Fft {
    fn name(&self) -> &'static str {
        "fft"
    }

    fn search(&mut self, question: &Question, peaks: &mut Vec<Peak>) {
        self.transform(question);
        let Some((_, map)) = &self.map else { return };
        let Question { batch, prior, search, lattice, .. } = question;
        let correlation = fast_global_align(map, batch, prior, search, lattice, &mut self.workspace);
        let norms = map.norm() * (batch.points.len() as f32).sqrt();
        let (best, score) = self.certain(question, &correlation, RELATIVE_ERROR * norms);
        peaks.clear();
        peaks.push(question.peak(best, score));
        let first = lattice.hypothesis(best);
        for index in correlation.highest(search.peaks, search.separation_m) {
            let distinct = lattice.hypothesis(index).distance_m(&first) >= search.separation_m;
            if distinct && peaks.len() < search.peaks {
                peaks.push(question.peak(index, correlation.values[index].round() as u32));
            }
        }
    }
}

impl Fft {
    /// The map's spectrum, unless it is that of the last question.
    fn transform(&mut self, question: &Question) {
        let square @ Square { frame, tiles } = question.view.square();
        if self.map.as_ref().is_some_and(|(of, _)| of.is(*frame, tiles)) {
            return;
        }
        let plans = self.plans.entry(frame.side).or_insert_with(|| Arc::new(Plans::new(frame.side)));
        let image = MapImage::of_weights(&question.view.fine(), Arc::clone(plans));
        self.map = Some((square.clone(), image));
    }

    /// The maximum beyond rounding: what comes within the error of the highest value is summed up
    /// anew in integers.
    fn certain(&mut self, question: &Question, correlation: &Correlation, error: f32) -> (usize, u32) {
        let lattice = question.lattice;
        let high = correlation.values.iter().fold(f32::MIN, |a, b| a.max(*b)) - 2.0 * error;
        let (mut best, mut drawn) = ((0, 0), usize::MAX);
        for (index, _) in correlation.values.iter().enumerate().filter(|(_, value)| **value >= high) {
            let heading = index / lattice.plane();
            if heading != drawn {
                question.occupied(Isa::best(), heading, &mut self.once, &mut self.occupied);
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
