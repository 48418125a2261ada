//! How the figures of a report were made: by which machine and command, from which data.

use super::record::EpochRecord;
use super::run::EvaluationPlan;
use super::section::Section;
use super::worlds::Worlds;
use crate::machine::Machine;

/// How the figures of a run were made.
pub struct About {
    machine: String,
    command: String,
    worlds: String,
    simulated: bool,
    fixes: usize,
    seed: u64,
}

impl About {
    /// The description of this run.
    pub fn of(worlds: &Worlds, plan: &EvaluationPlan, rows: &[EpochRecord]) -> Self {
        Self {
            machine: Machine::here().to_string(),
            command: command(std::env::args()),
            worlds: worlds.words(),
            simulated: matches!(worlds, Worlds::Simulated(_)),
            fixes: rows.len(),
            seed: plan.seed,
        }
    }

    /// True when the data are simulated towns, which the pages are about, and not drive logs.
    pub fn is_simulated(&self) -> bool {
        self.simulated
    }
}

/// The command line, with file names without their folders.
fn command(args: impl Iterator<Item = String>) -> String {
    let base = |word: String| word.rsplit('/').next().unwrap_or_default().to_owned();
    let rest = args.skip(1).map(base).collect::<Vec<_>>().join(" ");
    format!("echofix {rest}")
}

const SIMULATED: &str =
    "Each town is mapped on a Thursday. On the Sunday after, another vehicle drives the route of the first
contributor; other cars are parked by then, and the traffic is another. Batches are organised by odometry
without drift unless a table says otherwise. The towns have the parameters of `echofix_sim::downtown`. Its
documentation says which of them were tuned to come near the paper's printed figures; only the paper's method
was used for that. Errors are measured against the exact truth. The paper measured them against the reference
solution of the localized drive, which has errors of its own; the last columns of the first table do the same.";

const METHOD: &str = "`paper` is the paper's algorithm as printed: the hypothesis of the highest correlation, with movers in maps and
batches. `echofix` is what the service answers; its batches are organised by odometry that radial speeds
corrected. Both get the same epochs: about a second of driving apart, after at least a second above 1 m/s. Both
get the same priors, of sigma 2 m and 3 deg. Figures are 50 / **95** / 99 percentiles. Brackets hold 95 %
confidence intervals, by a bootstrap over blocks of two minutes, because epochs near each other are not
independent. `Map's own error` is the mean error of the poses that the map was made from. No method that aligns
with the map can detect it.";

/// The data and methods that all experiments have in common.
pub fn shared(about: &About) -> String {
    if about.simulated { format!("{SIMULATED}\n\n{METHOD}") } else { METHOD.to_owned() }
}

/// The whole report: first what all experiments have in common, then each experiment between its own markers.
pub fn page(about: &About, sections: &[Section]) -> String {
    let shared = shared(about);
    let marked = |section: &Section| {
        let (name, part) = part(about, section);
        format!("<!-- {name}:begin -->\n{part}\n<!-- {name}:end -->\n")
    };
    let head = format!("# The paper's experiments\n\n{shared}\n");
    let head = sections.iter().any(|section| section.data.is_none()).then_some(head);
    head.into_iter().chain(sections.iter().map(marked)).collect::<Vec<_>>().join("\n")
}

/// The name of an experiment's markers, and the text between them.
pub fn part(about: &About, section: &Section) -> (String, String) {
    let About { machine, command, worlds, fixes, seed, .. } = about;
    let text = section.text.trim_end();
    let shared = || format!("{fixes} fixes, priors of seed {seed}. {worlds}");
    let data = section.data.clone().unwrap_or_else(shared);
    let part = format!("{text}\n\nBy `{command}`: {data} On {machine}.");
    (format!("evaluate-{}", section.experiment.word()), part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_names_no_folder() {
        let words = ["/opt/x/echofix", "evaluate", "--drive", "/data/a.mcap", "--write", "."];
        assert_eq!(command(words.map(String::from).into_iter()), "echofix evaluate --drive a.mcap --write .");
    }
}
