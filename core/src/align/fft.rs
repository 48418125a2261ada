//! Cross-correlation of the map with a batch for one heading, by the FFT
//! (eq. linear-cross-correlation).
//!
//! Both images are real, so half a spectrum is enough. Spectra are stored column by column: the
//! transform along y of the batch, the product with the map and the inverse along y then happen
//! while one column is in the cache, and of the inverse along x only the rows of wanted lags are
//! computed. The map fills the array; only the batch is padded, by the half width of the search
//! (Sec. "Minimal Padding"): a shifted hypothesis loses no overlap.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};

/// Rows transformed together, so that the transposed write fills a cache line.
const ROWS: usize = 8;

/// Plans for one side length; shared by threads.
pub struct Plans {
    side: usize,
    row_forward: Arc<dyn RealToComplex<f32>>,
    row_inverse: Arc<dyn ComplexToReal<f32>>,
    column_forward: Arc<dyn Fft<f32>>,
    column_inverse: Arc<dyn Fft<f32>>,
}

/// The half spectrum of an image: `side / 2 + 1` columns of `side` values.
pub struct Spectrum {
    columns: Vec<Complex32>,
}

impl Spectrum {
    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.columns.len() * size_of::<Complex32>()
    }
}

/// Buffers that one thread reuses from batch to batch.
#[derive(Default)]
pub struct FftWorkspace {
    row: Vec<f32>,
    block: Vec<Complex32>,
    columns: Vec<Complex32>,
    lag_rows: Vec<Complex32>,
    scratch: Vec<Complex32>,
}

impl Plans {
    /// Plans transforms of `side` x `side` images.
    #[must_use]
    pub fn new(side: usize) -> Self {
        let (mut real, mut complex) = (RealFftPlanner::new(), FftPlanner::new());
        Self {
            side,
            row_forward: real.plan_fft_forward(side),
            row_inverse: real.plan_fft_inverse(side),
            column_forward: complex.plan_fft_forward(side),
            column_inverse: complex.plan_fft_inverse(side),
        }
    }

    /// Side of the images, cells.
    #[must_use]
    pub fn side(&self) -> usize {
        self.side
    }

    /// The spectrum of an image in row-major order (`side * side` values).
    #[must_use]
    pub fn spectrum(&self, image: &[f32], workspace: &mut FftWorkspace) -> Spectrum {
        let mut columns = Vec::new();
        self.transform_rows(image, workspace, &mut columns);
        workspace.scratch.resize(self.scratch_len(), Complex32::default());
        for column in columns.chunks_exact_mut(self.side) {
            self.column_forward.process_with_scratch(column, &mut workspace.scratch);
        }
        Spectrum { columns }
    }

    /// Correlates the map with a batch image for every shift of at most `lag` cells along either
    /// axis: `out[(dy + lag) * (2 lag + 1) + dx + lag]` is the sum of products when the batch is
    /// shifted by (dx, dy).
    ///
    /// The batch image must be 0 within `lag` cells of its border, or shifts would wrap around.
    pub fn correlate(
        &self,
        map: &Spectrum,
        batch: &[f32],
        lag: usize,
        workspace: &mut FftWorkspace,
        out: &mut [f32],
    ) {
        let n = self.side;
        let half = n / 2 + 1;
        let width = 2 * lag + 1;
        let mut columns = std::mem::take(&mut workspace.columns);
        self.transform_rows(batch, workspace, &mut columns);
        workspace.scratch.resize(self.scratch_len(), Complex32::default());
        workspace.lag_rows.resize(width * half, Complex32::default());
        let pairs = columns.chunks_exact_mut(n).zip(map.columns.chunks_exact(n));
        for (k, (column, map_column)) in pairs.enumerate() {
            self.column_forward.process_with_scratch(column, &mut workspace.scratch);
            for (b, m) in column.iter_mut().zip(map_column) {
                *b = m * b.conj();
            }
            self.column_inverse.process_with_scratch(column, &mut workspace.scratch);
            for row in 0..width {
                workspace.lag_rows[row * half + k] = column[(row + n - lag) % n];
            }
        }
        workspace.columns = columns;
        self.inverse_rows(lag, workspace, out);
    }

    /// The inverse along x of the rows of wanted lags.
    fn inverse_rows(&self, lag: usize, workspace: &mut FftWorkspace, out: &mut [f32]) {
        let n = self.side;
        let (half, width) = (n / 2 + 1, 2 * lag + 1);
        let scale = 1.0 / (n as f32 * n as f32);
        workspace.row.resize(n, 0.0);
        for (row, out) in workspace.lag_rows.chunks_exact_mut(half).zip(out.chunks_exact_mut(width)) {
            // Rounding leaves these two with an imaginary part that a real signal cannot have.
            row[0].im = 0.0;
            row[half - 1].im = 0.0;
            self.row_inverse
                .process_with_scratch(row, &mut workspace.row, &mut workspace.scratch)
                .expect("the buffers have the planned lengths");
            for (dx, value) in out.iter_mut().enumerate() {
                *value = workspace.row[(dx + n - lag) % n] * scale;
            }
        }
    }

    /// The transform along x of every row that holds anything, written column by column.
    fn transform_rows(&self, image: &[f32], workspace: &mut FftWorkspace, columns: &mut Vec<Complex32>) {
        let n = self.side;
        let half = n / 2 + 1;
        columns.clear();
        columns.resize(n * half, Complex32::default());
        workspace.row.resize(n, 0.0);
        workspace.block.resize(ROWS * half, Complex32::default());
        workspace.scratch.resize(self.scratch_len(), Complex32::default());
        for (index, rows) in image.chunks(ROWS * n).enumerate() {
            if rows.iter().all(|v| *v == 0.0) {
                continue;
            }
            let count = rows.len() / n;
            for (row, spectrum) in rows.chunks_exact(n).zip(workspace.block.chunks_exact_mut(half)) {
                workspace.row.copy_from_slice(row);
                self.row_forward
                    .process_with_scratch(&mut workspace.row, spectrum, &mut workspace.scratch)
                    .expect("the buffers have the planned lengths");
            }
            for k in 0..half {
                let to = k * n + index * ROWS;
                for (row, value) in columns[to..to + count].iter_mut().enumerate() {
                    *value = workspace.block[row * half + k];
                }
            }
        }
    }

    fn scratch_len(&self) -> usize {
        [
            self.row_forward.get_scratch_len(),
            self.row_inverse.get_scratch_len(),
            self.column_forward.get_inplace_scratch_len(),
            self.column_inverse.get_inplace_scratch_len(),
        ]
        .into_iter()
        .max()
        .unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The definition: eq. phd-discrete-correlation for one heading.
    fn by_hand(map: &[f32], batch: &[f32], side: usize, lag: usize) -> Vec<f32> {
        let lag = lag as i64;
        let mut out = Vec::new();
        for dy in -lag..=lag {
            for dx in -lag..=lag {
                let mut sum = 0.0;
                for (index, b) in batch.iter().enumerate().filter(|(_, b)| **b != 0.0) {
                    let (x, y) = ((index % side) as i64 + dx, (index / side) as i64 + dy);
                    sum += b * map[(y * side as i64 + x) as usize];
                }
                out.push(sum);
            }
        }
        out
    }

    #[test]
    fn the_fft_computes_the_correlation_of_the_definition() {
        for (seed, side, lag) in [(1, 40, 3), (2, 60, 10), (3, 50, 0), (4, 54, 7)] {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let map: Vec<f32> = (0..side * side).map(|_| rng.random_range(-0.1..0.9)).collect();
            let mut batch = vec![0.0; side * side];
            for _ in 0..80 {
                let (x, y) = (rng.random_range(lag..side - lag), rng.random_range(lag..side - lag));
                batch[y * side + x] = rng.random_range(0.1..0.9);
            }
            let plans = Plans::new(side);
            let mut workspace = FftWorkspace::default();
            let spectrum = plans.spectrum(&map, &mut workspace);
            let mut out = vec![0.0; (2 * lag + 1).pow(2)];
            plans.correlate(&spectrum, &batch, lag, &mut workspace, &mut out);
            for (index, (got, expected)) in out.iter().zip(by_hand(&map, &batch, side, lag)).enumerate() {
                assert!((got - expected).abs() < 1e-3, "seed {seed}, lag {index}: {got} {expected}");
            }
        }
    }
}
