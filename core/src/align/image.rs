//! The map as an image that a batch is correlated with, and its spectrum.

use std::sync::Arc;

use super::fft::{FftWorkspace, Plans, Spectrum};
use super::view::ImageView;
use crate::evidence::InverseSensorModel;
use crate::window::{EvidenceWindow, MapSquare};

/// Numbers of hits that have a value of their own; more have the last one.
const HITS: u32 = 64;

/// A map's image and its spectrum (fastGlobalAlign l. 1-2), and the value of a batch's cell on it. It depends on
/// the map alone, so one serves every batch in the same map window.
pub struct MapImage {
    square: MapSquare,
    plans: Arc<Plans>,
    spectrum: Spectrum,
    norm: f32,
    /// Value of a batch's cell by its hits, from 0.
    cell_value: Vec<f32>,
}

impl MapImage {
    /// Paper only, used by the evaluation: occupancy of map and batch, with the prior belief subtracted.
    #[must_use]
    pub fn of_evidence(window: &EvidenceWindow, model: &InverseSensorModel, plans: Arc<Plans>) -> Self {
        let square = window.square;
        let mut image = vec![0.0_f32; square.side * square.side];
        for cell in &window.cells {
            let index = usize::from(cell.y) * square.side + usize::from(cell.x);
            image[index] = model.evidence(cell.cell.hits) as f32;
        }
        let cell_value = (0..HITS).map(|hits| model.evidence(hits) as f32).collect();
        Self::new(square, &image, cell_value, plans)
    }

    /// Weights of the map, and occupied cells of the batch.
    #[must_use]
    pub fn of_weights(image: &ImageView, plans: Arc<Plans>) -> Self {
        let cells = image.side * image.side;
        let weights: Vec<f32> = image.weights[..cells].iter().map(|v| f32::from(*v)).collect();
        Self::new(image.square, &weights, vec![0.0, 1.0], plans)
    }

    fn new(square: MapSquare, image: &[f32], cell_value: Vec<f32>, plans: Arc<Plans>) -> Self {
        let spectrum = plans.spectrum(image, &mut FftWorkspace::default());
        let norm = image.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt() as f32;
        Self { square, plans, spectrum, norm, cell_value }
    }

    /// Where it lies.
    #[must_use]
    pub fn square(&self) -> MapSquare {
        self.square
    }

    /// Square root of the sum of its squared values.
    #[must_use]
    pub fn norm(&self) -> f32 {
        self.norm
    }

    /// Values of a batch's cell by its hits, from 0; more hits have the last one.
    #[must_use]
    pub fn cell_values(&self) -> &[f32] {
        &self.cell_value
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.spectrum.bytes()
    }

    pub(super) fn spectrum(&self) -> &Spectrum {
        &self.spectrum
    }

    pub(super) fn plans(&self) -> &Plans {
        &self.plans
    }
}
