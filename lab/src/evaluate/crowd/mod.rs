//! The crowd's map: experiments with their own towns, vehicles and uploads.
//!
//! - [`town`]: drives in a small town on many days; [`uploads`]: the uploads of a drive.
//! - [`map`]: a map that is made as the service makes it; [`fixes`]: localizes a drive on it.
//! - [`year`]: how maps age; [`attack`], [`attacks`]: what bad contributors can do.
//! - [`vetting`]: which uploads vetting keeps out; [`support`]: how many contributors must agree for a cell to be served.
//! - [`size`]: the size of uploads against the accuracy of the map; [`layer`]: of what a vehicle keeps of it.
//! - [`demand`]: uploads of what is wanted only.

pub mod attack;
pub mod attacks;
pub mod demand;
pub mod fixes;
pub mod layer;
pub mod map;
pub mod size;
pub mod support;
pub mod town;
pub mod uploads;
pub mod vetting;
pub mod year;

use std::fmt::Write as _;

use serde::Serialize;
use serde_json::Value;

use super::condition::Experiment;
use super::section::Section;

/// How much an experiment simulates.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale {
    /// Seeds of towns. An experiment takes the first of them, as many as it needs.
    pub towns: Vec<u64>,
    /// Whether to simulate little, which shows only whether the experiment works.
    pub quick: bool,
}

impl Scale {
    /// The seeds of at most `most` towns; of one town when quick.
    fn towns(&self, most: usize) -> &[u64] {
        let most = if self.quick { 1 } else { most };
        &self.towns[..self.towns.len().min(most)]
    }
}

/// The towns in words, for the report.
fn towns_in_words(towns: &[u64]) -> String {
    let seeds: Vec<_> = towns.iter().map(u64::to_string).collect();
    format!("Simulated towns of four blocks of the seeds {}.", seeds.join(", "))
}

/// A table with these columns and rows. The cells of a row are already separated by bars.
pub fn table<C: AsRef<str>>(columns: &[C], rows: impl IntoIterator<Item = String>) -> String {
    let heads = columns.iter().map(AsRef::as_ref).collect::<Vec<_>>().join(" | ");
    let mut table = format!("| {} |\n|{}\n", heads, "---|".repeat(heads.matches(" | ").count() + 1));
    for row in rows {
        let _ = writeln!(table, "| {row} |");
    }
    table
}

/// The result of an experiment: a section of the report, and the lines of its table as JSON.
pub struct CrowdSection {
    /// The section of the report.
    pub section: Section,
    /// The lines of its table, as JSON.
    pub lines: Value,
}

impl CrowdSection {
    fn new<T: Serialize>(section: Section, lines: &[T]) -> anyhow::Result<Self> {
        Ok(Self { section, lines: serde_json::to_value(lines)? })
    }

    /// The result of an experiment of the data described in words.
    pub fn with_data<T: Serialize>(
        experiment: Experiment,
        text: String,
        data: String,
        lines: &[T],
    ) -> anyhow::Result<Self> {
        Self::new(Section { experiment, text, figures: Vec::new(), data: Some(data) }, lines)
    }

    /// The result of an experiment whose section is a text and a table.
    fn of_table<T: Serialize>(
        experiment: Experiment,
        words: &str,
        table: &str,
        towns: &[u64],
        lines: &[T],
    ) -> anyhow::Result<Self> {
        let (text, data) = (format!("{words}\n{table}"), Some(towns_in_words(towns)));
        Self::new(Section { experiment, text, figures: Vec::new(), data }, lines)
    }
}

/// Runs one of [`Experiment::OF_THE_CROWD`]; `None` for all other experiments.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(experiment: Experiment, scale: &Scale) -> anyhow::Result<Option<CrowdSection>> {
    Ok(Some(match experiment {
        Experiment::Year => year::run(scale)?,
        Experiment::Attacks => attacks::run(scale)?,
        Experiment::Vetting => vetting::run(scale)?,
        Experiment::Upload => size::run(scale)?,
        Experiment::Layer => layer::run(scale)?,
        Experiment::Demand => demand::run(scale)?,
        Experiment::Support => support::run(scale)?,
        _ => return Ok(None),
    }))
}
