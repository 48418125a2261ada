//! A window with everything that aligning against it needs.

use std::sync::Arc;

use super::fft::{Plans, Spectrum, Workspace};
use super::{Search, Surface};
use crate::agreement::PointIndex;
use crate::window::{Frame, Window};

/// A window, its spectrum, its smoothed surface and its points: computed once, used by every
/// request around here.
pub struct PreparedMap {
    window: Window,
    plans: Arc<Plans>,
    spectrum: Spectrum,
    surface: Surface,
    points: PointIndex,
}

impl PreparedMap {
    /// Prepares a window; `plans` must be for its side.
    #[must_use]
    pub fn new(window: Window, plans: Arc<Plans>, search: &Search) -> Self {
        let frame = window.frame;
        // fastGlobalAlign l. 1: D_m, with the prior belief subtracted.
        let mut occupancy = vec![0.0_f32; frame.side * frame.side];
        for cell in &window.cells {
            let index = usize::from(cell.y) * frame.side + usize::from(cell.x);
            occupancy[index] = search.model.evidence(cell.cell.hits) as f32;
        }
        // l. 2
        let spectrum = plans.spectrum(&occupancy, &mut Workspace::default());
        let surface = Surface::of(&window);
        let points = PointIndex::new(window.cells.iter().map(|c| frame.to_metres(c.centroid())));
        Self { window, plans, spectrum, surface, points }
    }

    /// The window.
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// Which square of the map.
    pub fn frame(&self) -> Frame {
        self.window.frame
    }

    /// The smoothed log weights.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// The map's points, for nearest-neighbour questions.
    pub fn points(&self) -> &PointIndex {
        &self.points
    }

    /// Bytes held, approximately.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.spectrum.bytes() + self.surface.bytes() + self.window.cells.len() * 64
    }

    pub(super) fn spectrum(&self) -> &Spectrum {
        &self.spectrum
    }

    pub(super) fn plans(&self) -> &Plans {
        &self.plans
    }
}
