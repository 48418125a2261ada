//! What a crowd makes of a map: experiments with towns, vehicles and uploads of their own.
//!
//! - [`town`]: a small town, driven through on many days; [`uploads`]: a drive, cut as a vehicle sends it.
//! - [`map`]: a map made the service's way; [`fixes`]: what it is worth.
//! - [`year`]: how maps age; [`attack`], [`attacks`]: what bad contributors reach.
//! - [`vetting`]: which uploads are kept out; [`size`]: bytes of an upload against accuracy.

pub mod attack;
pub mod attacks;
pub mod fixes;
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

/// How much is simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale {
    /// Seeds of towns; as many as the experiment takes.
    pub towns: Vec<u64>,
    /// Is a first impression enough?
    pub quick: bool,
}

impl Scale {
    /// The first so many towns, fewer when quick.
    fn towns(&self, most: usize) -> &[u64] {
        let most = if self.quick { 1 } else { most };
        &self.towns[..self.towns.len().min(most)]
    }
}

/// Where the figures come from.
fn towns_in_words(towns: &[u64]) -> String {
    let seeds: Vec<_> = towns.iter().map(u64::to_string).collect();
    format!("Simulated towns of four blocks of the seeds {}.", seeds.join(", "))
}

/// A table: its first line, then a line for each of `rows`, whose cells are separated already.
fn table<C: AsRef<str>>(columns: &[C], rows: impl IntoIterator<Item = String>) -> String {
    let heads = columns.iter().map(AsRef::as_ref).collect::<Vec<_>>().join(" | ");
    let mut table = format!("| {} |\n|{}\n", heads, "---|".repeat(heads.matches(" | ").count() + 1));
    for row in rows {
        let _ = writeln!(table, "| {row} |");
    }
    table
}

/// A part of the report, and the lines of its table for machines.
pub struct CrowdSection {
    /// For people.
    pub section: Section,
    /// For machines.
    pub lines: Value,
}

impl CrowdSection {
    fn new<T: Serialize>(section: Section, lines: &[T]) -> anyhow::Result<Self> {
        Ok(Self { section, lines: serde_json::to_value(lines)? })
    }

    /// Words and a table, of towns.
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

/// What comes of one of [`Experiment::OF_THE_CROWD`]; `None` for the others.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn run(experiment: Experiment, scale: &Scale) -> anyhow::Result<Option<CrowdSection>> {
    Ok(Some(match experiment {
        Experiment::Year => year::run(scale)?,
        Experiment::Attacks => attacks::run(scale)?,
        Experiment::Vetting => vetting::run(scale)?,
        Experiment::Upload => size::run(scale)?,
        Experiment::Support => support::run(scale)?,
        _ => return Ok(None),
    }))
}
