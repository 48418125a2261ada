//! What each step from the paper's method to the service's is worth.

use super::condition::{Condition, Experiment};
use super::groups::{Groups, methods, of_method};
use super::record::EpochRecord;
use super::section::{Section, under};
use super::tables;

const WORDS: &str = "## What each step is worth

From the paper's method to `echofix`, each line adds one step. The first step drops movers by their radial speeds, and corrects the
odometry by those of standing objects. The second takes log weights of smoothed hits instead of occupancy. The third refines the
candidate with unrounded, thinned points. The last estimates the drift with the pose; this is `echofix`. Two more lines show
`echofix` without radial speeds, and with an exact search. All lines have the same epochs and priors.
";

/// The section of the report.
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
