//! Under which conditions a fix is asked for.

use echofix_sim::{Drift, Growth};

/// The paper's batch length, seconds.
pub const BATCH_S: f64 = 5.0;

/// Under which conditions a fix is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition {
    /// Seconds of scans in the batch.
    pub batch_s: f64,
    /// Error of the trajectory that organises the batch.
    pub drift: Option<Drift>,
    /// Contributors that made the map.
    pub contributors: usize,
}

impl Condition {
    /// The paper's: 5 s, no drift, a map of one drive.
    pub const HEADLINE: Self = Self { batch_s: BATCH_S, drift: None, contributors: 1 };

    /// The paper's drifts at the end of 5 s, smallest first; of each level linear, then quadratic.
    pub fn drifts() -> Vec<Self> {
        let levels = Drift::PAPER_LEVELS.into_iter();
        let grown = |level| [Growth::Linear, Growth::Quadratic].map(|growth| Drift::over_5_s(level, growth));
        levels.flat_map(grown).map(|drift| Self { drift: Some(drift), ..Self::HEADLINE }).collect()
    }

    /// The paper's batch lengths.
    pub fn batches() -> Vec<Self> {
        [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0].map(|batch_s| Self { batch_s, ..Self::HEADLINE }).to_vec()
    }

    /// Maps of so many contributors.
    pub fn crowds(contributors: &[usize]) -> Vec<Self> {
        contributors.iter().map(|contributors| Self { contributors: *contributors, ..Self::HEADLINE }).collect()
    }

    /// How the drift grows, in a word; empty without.
    pub fn growth(&self) -> &'static str {
        match self.drift.map(|drift| drift.growth) {
            None => "",
            Some(Growth::Linear) => "linear",
            Some(Growth::Quadratic) => "quadratic",
        }
    }
}

/// Which part of the evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Experiment {
    /// 5 s batches, a map of one contributor.
    Headline,
    /// Batches of 1 to 8 s.
    Batch,
    /// Drift of the odometry.
    Drift,
    /// Maps of 1 to 20 contributors.
    Crowd,
    /// Streets made to be mistaken.
    Ambiguity,
}

impl Experiment {
    /// All of them, in the order of the report.
    pub const ALL: [Self; 5] = [Self::Headline, Self::Batch, Self::Drift, Self::Crowd, Self::Ambiguity];

    /// The conditions it compares.
    pub fn conditions(self, crowds: &[usize]) -> Vec<Condition> {
        match self {
            Self::Headline | Self::Ambiguity => vec![Condition::HEADLINE],
            Self::Batch => Condition::batches(),
            Self::Drift => Condition::drifts(),
            Self::Crowd => Condition::crowds(crowds),
        }
    }
}
