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
pub mod town;
pub mod uploads;
pub mod vetting;
pub mod year;

use super::condition::Experiment;
use super::sections::Section;

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
fn places(towns: &[u64]) -> String {
    let seeds: Vec<_> = towns.iter().map(u64::to_string).collect();
    format!("Simulated towns of four blocks of the seeds {}.", seeds.join(", "))
}

/// The section of one of [`Experiment::OF_THE_CROWD`]; `None` for the others.
///
/// # Errors
/// When a town or a drive cannot be simulated.
pub fn section(experiment: Experiment, scale: &Scale) -> anyhow::Result<Option<Section>> {
    Ok(Some(match experiment {
        Experiment::Year => year::section(scale)?,
        Experiment::Attacks => attacks::section(scale)?,
        Experiment::Vetting => vetting::section(scale)?,
        Experiment::Upload => size::section(scale)?,
        _ => return Ok(None),
    }))
}
