//! The worlds of a run: simulated towns and scenes, or drive logs.

use std::path::PathBuf;

use echofix_sim::Scene;

use super::condition::Condition;
use super::world::EvaluationWorld;
use super::{logged, simulated};

/// A simulated world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Simulated {
    /// The town of a seed.
    Town(u64),
    /// A scene of a seed.
    Street(Scene, u64),
}

/// The worlds of a run. They are made one after the other, because each needs much memory.
pub enum Worlds {
    /// Simulated worlds.
    Simulated(Vec<Simulated>),
    /// A drive log, localized on the map of others.
    Logs {
        /// The log that is localized.
        drive: PathBuf,
        /// The logs that the map is made of.
        map: Vec<PathBuf>,
        /// Whether batches are organised by the known poses.
        known: bool,
    },
}

impl Worlds {
    /// The towns of some seeds, then all scenes of the first two seeds of others (of the first one when `quick`).
    pub fn simulated(towns: &[u64], streets: &[u64], quick: bool) -> Self {
        let streets = &streets[..streets.len().min(if quick { 1 } else { 2 })];
        let of_seed = |seed: &u64| Scene::ALL.map(|scene| Simulated::Street(scene, *seed));
        let towns = towns.iter().map(|seed| Simulated::Town(*seed));
        Self::Simulated(towns.chain(streets.iter().flat_map(of_seed)).collect())
    }

    /// Number of worlds.
    pub fn count(&self) -> usize {
        match self {
            Self::Simulated(all) => all.len(),
            Self::Logs { .. } => 1,
        }
    }

    /// The conditions that are evaluated in a world: in scenes only those of the headline.
    pub fn conditions(&self, index: usize, all: &[Condition], base: Condition) -> Vec<Condition> {
        match self {
            Self::Simulated(worlds) if matches!(worlds[index], Simulated::Street(..)) => vec![base],
            _ => all.to_vec(),
        }
    }

    /// Makes a world, with the maps that its conditions need.
    ///
    /// # Errors
    /// When a log cannot be read, or a drive cannot be mapped from.
    pub fn world(
        &self,
        index: usize,
        conditions: &[Condition],
        max_sigma_m: f64,
    ) -> anyhow::Result<EvaluationWorld> {
        let crowds: Vec<usize> = conditions.iter().map(|c| c.contributors).collect();
        let most = crowds.iter().copied().max().unwrap_or(1);
        let drives = match self {
            Self::Simulated(all) => match all[index] {
                Simulated::Town(seed) => simulated::town(seed, most)?,
                Simulated::Street(scene, seed) => simulated::scene(scene, seed)?,
            },
            Self::Logs { drive, map, known } => logged::drives(drive, map, *known)?,
        };
        EvaluationWorld::new(index, drives, &crowds, max_sigma_m)
    }

    /// The worlds in words, for the report.
    pub fn words(&self) -> String {
        let Self::Simulated(all) = self else {
            return "Recorded drives.".to_owned();
        };
        let seeds: Vec<String> = all
            .iter()
            .filter_map(|world| match world {
                Simulated::Town(seed) => Some(seed.to_string()),
                Simulated::Street(..) => None,
            })
            .collect();
        format!("Simulated towns of the seeds {}.", seeds.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streets_are_asked_the_headline_only() {
        let worlds = Worlds::simulated(&[5, 6, 7], &[5, 6, 7], false);
        assert_eq!(worlds.count(), 3 + 2 * 4);
        let base = Condition::default();
        let all = [base, Condition { batch_s: 1.0, ..base }];
        assert_eq!(worlds.conditions(0, &all, base).len(), 2);
        assert_eq!(worlds.conditions(3, &all, base), [base]);
        assert_eq!(worlds.words(), "Simulated towns of the seeds 5, 6, 7.");
        assert_eq!(Worlds::simulated(&[5, 6], &[5, 6], true).count(), 2 + 4);
    }
}
