//! The yardstick: the correlation in double precision with complex transforms, the batch drawn anew
//! for every heading. And the paper's own shortcut, which turns the batch's spectrum instead.

use rustfft::num_complex::Complex64;

use super::{Engine, Peak, Question};
use crate::align::cells::Once;
use crate::align::fft2::Fft2;
use crate::align::simd::Isa;

/// How the batch is turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turning {
    /// Point by point.
    Points,
    /// `rotate2` of its spectrum (fastGlobalAlign l. 10).
    Spectrum,
}

/// The engine and its buffers.
pub struct Reference {
    turning: Turning,
    fft: Option<Fft2>,
    once: Once,
    occupied: Vec<u32>,
}

impl Default for Reference {
    fn default() -> Self {
        Self::new(Turning::Points)
    }
}

impl Reference {
    /// fastGlobalAlign as it is printed, about the prior: the batch's spectrum is turned, not the batch.
    /// Near the maximum, not equal to it.
    #[must_use]
    pub fn as_printed() -> Self {
        Self::new(Turning::Spectrum)
    }

    fn new(turning: Turning) -> Self {
        Self { turning, fft: None, once: Once::default(), occupied: Vec::new() }
    }

    /// The batch under a heading, drawn about the array's origin: what lies south or west of the prior
    /// is drawn at the array's other end. Spectra turn about the origin and nothing else.
    fn draw(&mut self, question: &Question, heading: usize) -> Vec<Complex64> {
        question.occupied(Isa::PLAIN, heading, &mut self.once, &mut self.occupied);
        let side = question.view.frame().side;
        let [px, py] = prior_cell(question);
        let lag = question.lattice.lag;
        let mut image = vec![Complex64::default(); side * side];
        for place in &self.occupied {
            let (x, y) = (*place as usize % side + lag, *place as usize / side + lag);
            image[(y + side - py) % side * side + (x + side - px) % side] = Complex64::new(1.0, 0.0);
        }
        image
    }
}

fn prior_cell(question: &Question) -> [usize; 2] {
    let prior = question.prior.pose;
    question.view.frame().to_cells([prior.x_m, prior.y_m]).map(|c| c as usize)
}

impl Engine for Reference {
    fn name(&self) -> &'static str {
        match self.turning {
            Turning::Points => "reference",
            Turning::Spectrum => "paper",
        }
    }

    fn search(&mut self, question: &Question, peaks: &mut Vec<Peak>) {
        let (lattice, side) = (question.lattice, question.view.frame().side);
        let fft = self.fft.take().filter(|fft| fft.side() == side).unwrap_or_else(|| Fft2::new(side));
        let shown = question.view.fine();
        // fastGlobalAlign l. 1-2
        let mut map: Vec<_> =
            shown.image[..side * side].iter().map(|v| Complex64::new(f64::from(*v), 0.0)).collect();
        fft.forward(&mut map);
        // l. 3-5
        let mut straight = self.draw(question, lattice.turns);
        fft.forward(&mut straight);
        let [px, py] = prior_cell(question);
        let (mut best, mut highest) = (0, f64::MIN);
        // l. 8-12
        for heading in 0..lattice.headings() {
            let mut product = match self.turning {
                Turning::Points => {
                    let mut turned = self.draw(question, heading);
                    fft.forward(&mut turned);
                    turned
                }
                Turning::Spectrum => fft.turned(&straight, lattice.turn_rad(heading)),
            };
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
        }
        self.fft = Some(fft);
        // l. 13
        peaks.clear();
        peaks.push(question.peak(best, highest.round() as u32));
    }
}
