//! The conditions under which fixes are made, and the experiments that compare them.

use echofix_sim::{Drift, Growth};

use super::method::MethodName;

/// The paper's batch length, seconds.
pub const BATCH_S: f64 = 5.0;

/// The conditions under which a fix is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition {
    /// Length of the batch, seconds.
    pub batch_s: f64,
    /// Drift of the trajectory that organises the batch; `None` without.
    pub drift: Option<Drift>,
    /// Number of contributors to the map.
    pub contributors: usize,
}

impl Default for Condition {
    /// The paper's conditions: batches of 5 s, no drift, a map of one drive.
    fn default() -> Self {
        Self { batch_s: BATCH_S, drift: None, contributors: 1 }
    }
}

impl Condition {
    /// The same conditions with each of the paper's drifts, smallest first; of each level linear, then quadratic.
    fn drifts(self) -> Vec<Self> {
        let levels = Drift::PAPER_LEVELS.into_iter();
        let grown = |level| [Growth::Linear, Growth::Quadratic].map(|growth| Drift::over_5_s(level, growth));
        levels.flat_map(grown).map(|drift| Self { drift: Some(drift), ..self }).collect()
    }

    /// The same conditions with the paper's largest drift, the quadratic one.
    fn drifted_most(self) -> Self {
        let [.., largest] = Drift::PAPER_LEVELS;
        Self { drift: Some(Drift::over_5_s(largest, Growth::Quadratic)), ..self }
    }

    /// The same conditions with each of the paper's batch lengths.
    fn batches(self) -> Vec<Self> {
        [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0].map(|batch_s| Self { batch_s, ..self }).to_vec()
    }

    /// The same conditions on maps of so many contributors.
    fn crowds(self, contributors: &[usize]) -> Vec<Self> {
        contributors.iter().map(|contributors| Self { contributors: *contributors, ..self }).collect()
    }

    /// The value of what an experiment varies, in a few words.
    pub fn name(&self, experiment: Experiment) -> String {
        match (experiment, self.drift) {
            (Experiment::Batch, _) => format!("{:.0} s", self.batch_s),
            (Experiment::Crowd, _) if self.contributors == 1 => "1 contributor".to_owned(),
            (Experiment::Crowd, _) => format!("{} contributors", self.contributors),
            (Experiment::Drift | Experiment::Ablation, Some(drift)) => {
                let (cm, deg) = (100.0 * drift.sigma_position_m, drift.sigma_yaw_rad.to_degrees());
                format!("{} {cm:.0} cm, {deg:.2} deg", self.growth())
            }
            (Experiment::Ablation, None) => "no drift".to_owned(),
            _ => format!("{:.0} s, {} contributor(s)", self.batch_s, self.contributors),
        }
    }

    /// How the drift grows, in a word; empty without drift.
    pub fn growth(&self) -> &'static str {
        match self.drift.map(|drift| drift.growth) {
            None => "",
            Some(Growth::Linear) => "linear",
            Some(Growth::Quadratic) => "quadratic",
        }
    }
}

/// A part of the evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Experiment {
    /// Fixes from 5 s batches on a map of one contributor.
    Headline,
    /// Batches of 1 to 8 s.
    Batch,
    /// Odometry with drift.
    Drift,
    /// Maps of 1 to 20 contributors.
    Crowd,
    /// Scenes with many positions that look alike.
    Ambiguity,
    /// What the map alone expects of fixes, beside the fixes.
    Localizability,
    /// The steps from the paper's method to the service's, one at a time.
    Ablation,
    /// How often the fast search misses the exact maximum.
    Misses,
    /// How maps age over a year.
    Year,
    /// What bad contributors can do to the map.
    Attacks,
    /// Which uploads vetting keeps out of the map.
    Vetting,
    /// The size of uploads against the accuracy of the map.
    Upload,
    /// The size of a vehicle's map against its accuracy.
    Layer,
    /// Uploads of what is wanted only, against all.
    Demand,
    /// How many contributors must have hit something near a cell for it to be served.
    Support,
    /// Whether answers may be believed, in families of worlds that nothing was tuned on.
    Trust,
    /// The drive logs of `--drives`. No `--only` names it.
    #[value(skip)]
    Drives,
}

impl Experiment {
    /// The experiments that run when none is named, in the order of the report. Their fixes are of one run.
    pub const ALL: [Self; 8] = [
        Self::Headline,
        Self::Batch,
        Self::Drift,
        Self::Crowd,
        Self::Ambiguity,
        Self::Localizability,
        Self::Ablation,
        Self::Misses,
    ];

    /// Experiments with their own towns and maps. They run only when they are named.
    pub const OF_THE_CROWD: [Self; 9] = [
        Self::Year,
        Self::Attacks,
        Self::Vetting,
        Self::Upload,
        Self::Layer,
        Self::Demand,
        Self::Support,
        Self::Trust,
        Self::Drives,
    ];

    /// Its name on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Headline => "headline",
            Self::Batch => "batch",
            Self::Drift => "drift",
            Self::Crowd => "crowd",
            Self::Ambiguity => "ambiguity",
            Self::Localizability => "localizability",
            Self::Ablation => "ablation",
            Self::Misses => "misses",
            Self::Year => "year",
            Self::Attacks => "attacks",
            Self::Vetting => "vetting",
            Self::Upload => "upload",
            Self::Layer => "layer",
            Self::Demand => "demand",
            Self::Support => "support",
            Self::Trust => "trust",
            Self::Drives => "drives",
        }
    }

    /// The page in `docs/benchmarks` that contains its section.
    pub fn page(self) -> &'static str {
        match self {
            Self::Localizability => "localizability.md",
            Self::Misses => "search.md",
            Self::Trust => "trust.md",
            Self::Layer => "layer.md",
            Self::Drives => "drives.md",
            Self::Year | Self::Attacks | Self::Vetting | Self::Upload | Self::Demand | Self::Support => {
                "crowd.md"
            }
            Self::Headline | Self::Batch | Self::Drift | Self::Crowd | Self::Ambiguity | Self::Ablation => {
                "paper.md"
            }
        }
    }

    /// The methods it compares besides those of `--methods`.
    pub fn variants(self) -> &'static [MethodName] {
        match self {
            Self::Ablation => &MethodName::LADDER,
            Self::Misses => &[MethodName::Echofix, MethodName::Exact],
            _ => &[],
        }
    }

    /// Whether it needs the scenes with many positions that look alike.
    pub fn scenes(self) -> bool {
        matches!(self, Self::Ambiguity | Self::Localizability | Self::Misses)
    }

    /// The conditions it compares, which are variations of `base`.
    pub fn conditions(self, base: Condition, crowds: &[usize]) -> Vec<Condition> {
        match self {
            Self::Headline | Self::Ambiguity | Self::Localizability | Self::Misses => vec![base],
            Self::Ablation => vec![base, base.drifted_most()],
            Self::Batch => base.batches(),
            Self::Drift => base.drifts(),
            Self::Crowd => base.crowds(crowds),
            Self::Year
            | Self::Attacks
            | Self::Vetting
            | Self::Upload
            | Self::Layer
            | Self::Demand
            | Self::Support
            | Self::Trust
            | Self::Drives => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn experiments_vary_one_thing_each() {
        let base = Condition::default();
        for experiment in Experiment::ALL {
            let all = experiment.conditions(base, &[1, 5]);
            let names: std::collections::BTreeSet<_> = all.iter().map(|c| c.name(experiment)).collect();
            assert_eq!(names.len(), all.len(), "{names:?}");
            let varied = |differs: fn(&Condition, &Condition) -> bool| all.iter().any(|c| differs(c, &base));
            let varied = [
                varied(|a, b| a.batch_s > b.batch_s),
                varied(|a, b| a.drift != b.drift),
                varied(|a, b| a.contributors != b.contributors),
            ];
            assert!(varied.iter().filter(|v| **v).count() <= 1);
        }
    }
}
