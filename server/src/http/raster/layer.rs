//! What can be drawn.

use std::fmt;
use std::str::FromStr;

use crate::http::error::Error;

/// From this zoom on a view shows what can be expected of fixes: at most some 120 tiles lie under it.
const EXPECTATIONS_FROM: u8 = 16;

/// A layer of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Layer {
    /// Occupied cells, by how much stands behind them.
    Evidence,
    /// Which tiles exist.
    Coverage,
    /// Occupied cells, by the days since they were last seen.
    Age,
    /// How well fixes can be expected to be.
    Localizability,
}

impl Layer {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Evidence, Self::Coverage, Self::Age, Self::Localizability];

    /// Its name in addresses.
    pub fn name(self) -> &'static str {
        match self {
            Self::Evidence => "evidence",
            Self::Coverage => "coverage",
            Self::Age => "age",
            Self::Localizability => "localizability",
        }
    }

    /// The first zoom that shows it: from farther away it would take too long to make.
    pub fn min_zoom(self) -> u8 {
        if self == Self::Localizability { EXPECTATIONS_FROM } else { 0 }
    }

    /// What it shows, in a sentence.
    pub fn description(self) -> &'static str {
        match self {
            Self::Evidence => "Occupied cells of 10 cm; brighter where more passes and detections agree.",
            Self::Coverage => "Tiles of 51.2 m that hold any evidence; brighter where they hold more.",
            Self::Age => {
                "Occupied cells by the days since they were last seen, counted from the map's newest day."
            }
            Self::Localizability => {
                "What fixes can be expected to be, by the map alone: their sigma along the weakest axis, or why there would be none."
            }
        }
    }
}

impl fmt::Display for Layer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Layer {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let expected = || {
            Error::NotFound(format!("no layer `{text}`; expected evidence, coverage, age or localizability"))
        };
        Self::ALL.into_iter().find(|layer| layer.name() == text).ok_or_else(expected)
    }
}
