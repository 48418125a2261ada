//! The map as an image that a batch is correlated with, and its spectrum.

use std::sync::Arc;

use super::fft::{Plans, Spectrum, Workspace};
use super::view::Shown;
use crate::evidence::InverseSensorModel;
use crate::window::{Frame, Window};

/// Numbers of hits that have a value of their own; more are worth no more.
const HITS: u32 = 64;

/// A map's image, transformed (fastGlobalAlign l. 1-2), and what a cell of a batch is worth on it.
pub struct MapImage {
    frame: Frame,
    plans: Arc<Plans>,
    spectrum: Spectrum,
    norm: f32,
    /// Value of a batch's cell by its hits, from 0.
    cell_value: Vec<f32>,
}

impl MapImage {
    /// The paper's: occupancy of map and batch, with the prior belief subtracted.
    #[must_use]
    pub fn of_evidence(window: &Window, model: &InverseSensorModel, plans: Arc<Plans>) -> Self {
        let frame = window.frame;
        let mut image = vec![0.0_f32; frame.side * frame.side];
        for cell in &window.cells {
            let index = usize::from(cell.y) * frame.side + usize::from(cell.x);
            image[index] = model.evidence(cell.cell.hits) as f32;
        }
        let cell_value = (0..HITS).map(|hits| model.evidence(hits) as f32).collect();
        Self::new(frame, &image, cell_value, plans)
    }

    /// Weights of the map, and occupied cells of the batch.
    #[must_use]
    pub fn of_weights(shown: &Shown, plans: Arc<Plans>) -> Self {
        let image: Vec<f32> = shown.image[..shown.side * shown.side].iter().map(|v| f32::from(*v)).collect();
        Self::new(shown.frame, &image, vec![0.0, 1.0], plans)
    }

    fn new(frame: Frame, image: &[f32], cell_value: Vec<f32>, plans: Arc<Plans>) -> Self {
        let spectrum = plans.spectrum(image, &mut Workspace::default());
        let norm = image.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt() as f32;
        Self { frame, plans, spectrum, norm, cell_value }
    }

    /// Where it lies.
    #[must_use]
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// Square root of the sum of its squared values.
    #[must_use]
    pub fn norm(&self) -> f32 {
        self.norm
    }

    /// Values of a batch's cell by its hits, from 0; more hits are worth the last.
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
