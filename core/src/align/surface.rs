//! The map, smoothed to the sensor's noise, as log weights: what a pose is refined on.

use crate::geo::CELL_M;
use crate::window::Window;

/// Standard deviation of the smoothing, metres: about the spread of one structure's returns.
const SIGMA_M: f64 = 0.2;
/// Smoothed hits, for each pass that a typical hit's cell has seen, at which a weight starts to grow
/// like a logarithm: a crowd's map holds as many times the hits of a single survey's, and as many
/// times the clutter.
const KNEE_PER_PASS: f64 = 0.3;
/// The kernel ends here, in sigmas.
const REACH_SIGMAS: f64 = 3.0;
/// Steps of a cell to which a kernel's centre is rounded.
const PHASES: usize = 8;

/// `log(1 + smoothed hits / knee)` at the centre of every cell of a window.
///
/// Unlike occupancy it neither saturates after a few hits nor lets one bright cell outvote a wall.
pub struct Surface {
    side: usize,
    values: Vec<f32>,
}

impl Surface {
    /// Smooths a window's hits, each at its mean place within its cell.
    #[must_use]
    pub fn of(window: &Window) -> Self {
        let side = window.frame.side;
        let mut values = vec![0.0_f32; side * side];
        let kernels = Kernels::new();
        for cell in &window.cells {
            let [fx, fy] = cell.cell.centroid();
            let (kx, ky) = (kernels.at(fx), kernels.at(fy));
            let hits = cell.cell.hits as f32;
            let reach = kernels.reach as i64;
            let (x0, y0) = (i64::from(cell.x) - reach, i64::from(cell.y) - reach);
            for (y, wy) in (y0..).zip(ky).filter(|(y, _)| (0..side as i64).contains(y)) {
                for (x, wx) in (x0..).zip(kx).filter(|(x, _)| (0..side as i64).contains(x)) {
                    values[y as usize * side + x as usize] += hits * wy * wx;
                }
            }
        }
        let knee = (KNEE_PER_PASS * window.typical_passes()) as f32;
        for value in values.iter_mut().filter(|v| **v > 0.0) {
            *value = (1.0 + *value / knee).ln();
        }
        Self { side, values }
    }

    /// The weight at a place (cells from the south-west corner), bilinear between cell centres; 0
    /// outside.
    #[must_use]
    pub fn at(&self, x: f64, y: f64) -> f32 {
        let (x, y) = (x - 0.5, y - 0.5);
        let last = (self.side - 1) as f64;
        if !(x >= 0.0 && y >= 0.0 && x < last && y < last) {
            return 0.0;
        }
        let (ix, iy) = (x as usize, y as usize);
        let (fx, fy) = ((x - ix as f64) as f32, (y - iy as f64) as f32);
        let row = iy * self.side + ix;
        let below = self.values[row] * (1.0 - fx) + self.values[row + 1] * fx;
        let above = self.values[row + self.side] * (1.0 - fx) + self.values[row + self.side + 1] * fx;
        below * (1.0 - fy) + above * fy
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.values.len() * size_of::<f32>()
    }
}

/// Gaussian kernels along one axis, one for each phase of the centre within its cell.
struct Kernels {
    reach: usize,
    taps: Vec<Vec<f32>>,
}

impl Kernels {
    fn new() -> Self {
        let sigma = SIGMA_M / CELL_M;
        let reach = (REACH_SIGMAS * sigma).ceil() as usize;
        let taps = (0..PHASES).map(|phase| {
            let centre = reach as f64 + (phase as f64 + 0.5) / PHASES as f64 - 0.5;
            let taps = (0..=2 * reach).map(|i| (-0.5 * ((i as f64 - centre) / sigma).powi(2)).exp());
            let taps: Vec<f64> = taps.collect();
            let sum: f64 = taps.iter().sum();
            taps.into_iter().map(|t| (t / sum) as f32).collect()
        });
        Self { reach, taps: taps.collect() }
    }

    /// Taps for a centre at `fraction` of its cell.
    fn at(&self, fraction: f64) -> &[f32] {
        &self.taps[((fraction * PHASES as f64) as usize).min(PHASES - 1)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Cell;
    use crate::geo::{CellIndex, Zone};
    use crate::window::{Frame, WindowCell};

    #[test]
    fn the_weight_is_highest_where_the_hits_were() {
        let frame =
            Frame { zone: Zone::from_epsg(32614).unwrap(), origin: CellIndex { x: 0, y: 0 }, side: 64 };
        let mut window = Window::stitch(frame, []);
        // Mean place of the hits: (20.25, 30.75).
        let cell = Cell { hits: 4, passes: 1, offset_sum: [64 * 4, 192 * 4], ..Cell::default() };
        window.cells.push(WindowCell { x: 20, y: 30, cell });
        let surface = Surface::of(&window);
        let best = (0..6400)
            .map(|i| (15.0 + f64::from(i % 80) * 0.125, 25.0 + f64::from(i / 80) * 0.125))
            .max_by(|a, b| surface.at(a.0, a.1).total_cmp(&surface.at(b.0, b.1)))
            .unwrap();
        assert!((best.0 - 20.25).abs() <= 0.5 && (best.1 - 30.75).abs() <= 0.5, "{best:?}");
        assert!(surface.at(20.25, 30.75) > surface.at(23.0, 30.75));
        assert!(surface.at(1.0, 1.0).abs() < 1e-9 && surface.at(-4.0, 700.0).abs() < 1e-9);
    }
}
