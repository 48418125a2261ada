//! What each step from the paper's method to the service's is worth.

use super::condition::{Condition, Experiment};
use super::groups::{Groups, methods, of_method};
use super::record::EpochRecord;
use super::section::{Section, under};
use super::tables;

const WORDS: &str = "## What each step is worth

From the paper's method on, one step a line: movers gated by their radial speeds, which also correct the odometry; the log
weights of smoothed hits in place of occupancy; the candidate refined with unrounded, thinned points; odometry's drift as part of the
answer, which is `echofix`. Then the same without radial speeds, and with a search that is exact. At the same epochs, from
the same priors.
";

/// The section.
pub fn section(rows: &[&EpochRecord], base: Condition) -> Section {
    let experiment = Experiment::Ablation;
    let conditions = experiment.conditions(base, &[]);
    let mut groups = Groups::new();
    for condition in &conditions {
        let rows = under(rows, condition, true);
        let line = |method: &'static str| {
            (format!("{method}, {}", condition.name(experiment)), of_method(&rows, method))
        };
        groups.extend(methods(&rows).into_iter().map(line));
    }
    let count = groups.first().map_or(0, |(_, rows)| rows.len());
    let text = [WORDS, &format!("{count} fixes a line.\n"), &tables::sweep(&groups)].join("\n");
    Section { experiment, text, figures: Vec::new(), data: None }
}
