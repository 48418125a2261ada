//! What can be drawn.

use std::fmt;
use std::str::FromStr;

use crate::http::error::Error;

/// A layer of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Layer {
    /// Occupied cells, by how much stands behind them.
    Evidence,
    /// Which tiles exist.
    Coverage,
    /// Occupied cells, by the days since they were last seen.
    Age,
}

impl Layer {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Evidence, Self::Coverage, Self::Age];

    /// Its name in addresses.
    pub fn name(self) -> &'static str {
        match self {
            Self::Evidence => "evidence",
            Self::Coverage => "coverage",
            Self::Age => "age",
        }
    }

    /// What it shows, in a sentence.
    pub fn description(self) -> &'static str {
        match self {
            Self::Evidence => "Occupied cells of 10 cm; brighter where more passes and detections agree.",
            Self::Coverage => "Tiles of 51.2 m that hold any evidence; brighter where they hold more.",
            Self::Age => {
                "Occupied cells by the days since they were last seen, counted from the map's newest day."
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
        let expected = || Error::NotFound(format!("no layer `{text}`; expected evidence, coverage or age"));
        Self::ALL.into_iter().find(|layer| layer.name() == text).ok_or_else(expected)
    }
}
