//! How a map tile is drawn.
//!
//! A `view` is one Web-Mercator tile of pixels. From far away it shows the `overview`: blocks of
//! tiles, drawn straight onto the pixels. Nearer, each zone's evidence is gathered on its own
//! `plane`, pooled by maximum to about one block a pixel so that thin structure stays visible, and
//! every pixel is looked up through the exact projection. The `palette` turns what was found into
//! colour. The `artist` does this for a request, and remembers.

mod artist;
mod layer;
mod overview;
mod palette;
mod plane;
mod summary;
mod view;
mod view_content;

pub use artist::Artist;
pub use layer::Layer;
pub use overview::{Overview, corners};
pub use palette::{LegendEntry, legend};
pub use view::{MAX_ZOOM, View};

use echofix_core::align::localizability::{Expected, Localizability};
use echofix_core::evidence::Cell;
use palette::{AMBIGUOUS, TOO_LITTLE, level_of_sigma};

/// What a spot of the map shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Spot {
    /// Strength of the evidence, 1 to 255; 0 where nothing was ever seen.
    level: u8,
    /// Last UTC day it was seen.
    day: u16,
}

impl Spot {
    const NOTHING: Self = Self { level: 0, day: 0 };

    /// A cell, by how many passes and detections stand behind it: one pass may be a parked car,
    /// five are a wall.
    fn of_cell(cell: &Cell) -> Self {
        let hits = (f64::from(cell.hits).ln_1p() / 40_f64.ln_1p()).min(1.0);
        let passes = (f64::from(cell.passes.saturating_sub(1)) / 4.0).min(1.0);
        let level = 40.0 + 115.0 * hits + 100.0 * passes;
        Self { level: level as u8, day: cell.last_day }
    }

    /// A spot known by the number of its occupied cells only; `full` of them shine brightest.
    fn of_count(cells: u32, full: f64, day: u16) -> Self {
        let fraction = (f64::from(cells).ln_1p() / full.ln_1p()).min(1.0);
        Self { level: (30.0 + 190.0 * fraction * fraction) as u8, day }
    }

    /// A spot by what can be expected of fixes there.
    fn of_expected(expected: &Localizability, verdict: Expected) -> Self {
        let level = match verdict {
            Expected::TooLittleStructure => TOO_LITTLE,
            Expected::Ambiguous => AMBIGUOUS,
            Expected::Usable => level_of_sigma(expected.weakest_m()),
        };
        Self { level, day: 0 }
    }

    /// The stronger and the newer of two.
    fn raise(&mut self, other: Self) {
        self.level = self.level.max(other.level);
        self.day = self.day.max(other.day);
    }
}
