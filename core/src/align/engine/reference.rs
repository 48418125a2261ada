//! What the other engines are measured by: the correlation in double precision with complex transforms, the batch drawn anew
//! for every heading. And the paper's own shortcut, which turns the batch's spectrum instead.

use rustfft::num_complex::Complex64;

use super::{Candidate, Engine, EngineWorkspace, SearchQuestion};
use crate::align::fft2::Fft2;
use crate::align::projection::DistinctPixels;
use crate::align::simd::Isa;
use crate::point::MapPoint;

/// How the batch is turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turning {
    /// Point by point.
    Points,
    /// `rotate2` of its spectrum (fastGlobalAlign l. 10).
    Spectrum,
}

/// The engine.
#[derive(Debug, Clone, Copy)]
pub struct Reference {
    turning: Turning,
}

/// The transform of the last size, and the batch's cells.
#[derive(Default)]
struct ReferenceBuffers {
    fft: Option<Fft2>,
    distinct: DistinctPixels,
    occupied: Vec<u32>,
}

impl Default for Reference {
    fn default() -> Self {
        Self { turning: Turning::Points }
    }
}

impl Reference {
    /// Paper only, used by the evaluation: fastGlobalAlign as it is printed, about the prior. The batch's
    /// spectrum is turned, not the batch. Near the maximum, not equal to it.
    #[must_use]
    pub fn as_printed() -> Self {
        Self { turning: Turning::Spectrum }
    }
}

fn prior_cell(question: &SearchQuestion) -> [usize; 2] {
    question.view.square().to_cells(MapPoint::of(&question.prior.pose)).map(|c| c as usize)
}

impl Engine for Reference {
    fn name(&self) -> &'static str {
        match self.turning {
            Turning::Points => "reference",
            Turning::Spectrum => "paper",
        }
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        let buffers = workspace.buffers::<ReferenceBuffers>();
        for (question, candidates) in questions.iter().zip(candidates) {
            buffers.search(self.turning, question, candidates);
        }
    }
}

impl ReferenceBuffers {
    /// The batch under a heading, drawn about the array's origin: what lies south or west of the prior
    /// is drawn at the array's other end. Spectra turn about the origin and nothing else.
    fn draw(&mut self, question: &SearchQuestion, heading: usize) -> Vec<Complex64> {
        question.occupied(Isa::PLAIN, heading, &mut self.distinct, &mut self.occupied);
        let side = question.view.square().side;
        let [px, py] = prior_cell(question);
        let lag = question.lattice.lag;
        let mut image = vec![Complex64::default(); side * side];
        for pixel in &self.occupied {
            let (x, y) = (*pixel as usize % side + lag, *pixel as usize / side + lag);
            image[(y + side - py) % side * side + (x + side - px) % side] = Complex64::new(1.0, 0.0);
        }
        image
    }

    fn search(&mut self, turning: Turning, question: &SearchQuestion, candidates: &mut Vec<Candidate>) {
        let (lattice, side) = (question.lattice, question.view.square().side);
        let fft = self.fft.take().filter(|fft| fft.side() == side).unwrap_or_else(|| Fft2::new(side));
        let fine = question.view.fine();
        // l. 1: the map's grid. l. 2: its spectrum.
        let mut map: Vec<_> =
            fine.weights[..side * side].iter().map(|v| Complex64::new(f64::from(*v), 0.0)).collect();
        fft.forward(&mut map);
        // l. 3: the batch's points are organised by odometry already. l. 4: their grid. l. 5: its spectrum.
        let mut straight = self.draw(question, lattice.turns);
        let cells = self.occupied.len();
        fft.forward(&mut straight);
        let [px, py] = prior_cell(question);
        let (mut best, mut highest) = (0, f64::MIN);
        // l. 6 and 7: the lattice. l. 8 and 9: its headings.
        for heading in 0..lattice.headings() {
            // l. 10
            let mut product = match turning {
                Turning::Points => {
                    let mut turned = self.draw(question, heading);
                    fft.forward(&mut turned);
                    turned
                }
                Turning::Spectrum => fft.turned(&straight, lattice.turn_rad(heading)),
            };
            // l. 11
            for (b, m) in product.iter_mut().zip(&map) {
                *b = m * b.conj();
            }
            fft.inverse(&mut product);
            for index in 0..lattice.plane() {
                let (row, column) = (index / lattice.width(), index % lattice.width());
                let (y, x) = (py + side + row - lattice.lag, px + side + column - lattice.lag);
                let value = product[y % side * side + x % side].re;
                // Sums of integers: what differs by less than a half does not differ.
                if value > highest + 0.5 {
                    (best, highest) = (heading * lattice.plane() + index, value);
                }
            }
            // l. 12: the loop's end.
        }
        self.fft = Some(fft);
        // l. 13
        candidates.clear();
        candidates.push(question.candidate(best, highest.round() as u32, cells));
    }
}
