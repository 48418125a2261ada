//! Two-dimensional complex transforms in double precision: for the reference, not for speed.

use std::sync::Arc;

use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

/// Transforms of square images of one side.
pub struct Fft2 {
    side: usize,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

impl Fft2 {
    /// Plans transforms of `side` x `side` images.
    #[must_use]
    pub fn new(side: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self { side, forward: planner.plan_fft_forward(side), inverse: planner.plan_fft_inverse(side) }
    }

    /// Side of the images.
    #[must_use]
    pub fn side(&self) -> usize {
        self.side
    }

    /// An image becomes its spectrum.
    pub fn forward(&self, image: &mut [Complex64]) {
        self.both_ways(&*self.forward, image);
    }

    /// A spectrum becomes its image.
    pub fn inverse(&self, spectrum: &mut [Complex64]) {
        self.both_ways(&*self.inverse, spectrum);
        let scale = 1.0 / (self.side * self.side) as f64;
        for value in spectrum {
            *value *= scale;
        }
    }

    /// The spectrum of an image that is turned about the array's origin (`rotate2` of fastGlobalAlign
    /// l. 10): the spectrum turned by the same angle, interpolated between its four neighbours. Paper only: used
    /// by the evaluation.
    #[must_use]
    pub fn turned(&self, spectrum: &[Complex64], turn_rad: f64) -> Vec<Complex64> {
        let n = self.side as i64;
        let (s, c) = turn_rad.sin_cos();
        let signed = |k: usize| if k as i64 > n / 2 { k as i64 - n } else { k as i64 } as f64;
        let at = |x: i64, y: i64| spectrum[(y.rem_euclid(n) * n + x.rem_euclid(n)) as usize];
        (0..spectrum.len())
            .map(|index| {
                let (kx, ky) = (signed(index % self.side), signed(index / self.side));
                // The value at k comes from where the turn took it from.
                let (x, y) = (c * kx + s * ky, c * ky - s * kx);
                let (ix, iy) = (x.floor(), y.floor());
                let (fx, fy) = (x - ix, y - iy);
                let (ix, iy) = (ix as i64, iy as i64);
                let low = at(ix, iy) * (1.0 - fx) + at(ix + 1, iy) * fx;
                let high = at(ix, iy + 1) * (1.0 - fx) + at(ix + 1, iy + 1) * fx;
                low * (1.0 - fy) + high * fy
            })
            .collect()
    }

    fn both_ways(&self, fft: &dyn Fft<f64>, values: &mut [Complex64]) {
        fft.process(values);
        self.transpose(values);
        fft.process(values);
        self.transpose(values);
    }

    fn transpose(&self, values: &mut [Complex64]) {
        for row in 0..self.side {
            for column in row + 1..self.side {
                values.swap(row * self.side + column, column * self.side + row);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_turn_of_the_spectrum_is_a_quarter_turn_of_the_image() {
        let fft = Fft2::new(16);
        let mut image = vec![Complex64::default(); 256];
        // A bump at (3, 1); a quarter turn counter-clockwise takes it to (-1, 3).
        image[16 + 3] = Complex64::new(1.0, 0.0);
        fft.forward(&mut image);
        let mut turned = fft.turned(&image, std::f64::consts::FRAC_PI_2);
        fft.inverse(&mut turned);
        let best = (0..256).max_by(|a, b| turned[*a].re.total_cmp(&turned[*b].re)).unwrap();
        assert_eq!((best % 16, best / 16), (15, 3));
        assert!((turned[best].re - 1.0).abs() < 1e-9);
    }
}
