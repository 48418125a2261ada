//! Which worlds are evaluated: simulated towns and streets, or drive logs.

use std::path::PathBuf;

use echofix_sim::Scene;

use super::condition::Condition;
use super::world::EvaluationWorld;
use super::{logged, simulated};

/// A simulated world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Simulated {
    /// A town of a seed.
    Town(u64),
    /// A street of a seed.
    Street(Scene, u64),
}

/// Which worlds are evaluated, one after the other: each needs its memory.
pub enum Worlds {
    /// Simulated ones.
    Simulated(Vec<Simulated>),
    /// A drive log on the map of others.
    Logs {
        /// Localized.
        drive: PathBuf,
        /// Mapped.
        map: Vec<PathBuf>,
        /// Are batches organised by the known poses?
        known: bool,
    },
}

impl Worlds {
    /// Towns of some seeds, then each kind of street for the first two seeds of others (the first
    /// one when `quick`).
    pub fn simulated(towns: &[u64], streets: &[u64], quick: bool) -> Self {
        let streets = &streets[..streets.len().min(if quick { 1 } else { 2 })];
        let of_seed = |seed: &u64| Scene::ALL.map(|scene| Simulated::Street(scene, *seed));
        let towns = towns.iter().map(|seed| Simulated::Town(*seed));
        Self::Simulated(towns.chain(streets.iter().flat_map(of_seed)).collect())
    }

    /// How many.
    pub fn count(&self) -> usize {
        match self {
            Self::Simulated(all) => all.len(),
            Self::Logs { .. } => 1,
        }
    }

    /// The conditions asked in one of them: in streets the headline's only.
    pub fn conditions(&self, index: usize, all: &[Condition], base: Condition) -> Vec<Condition> {
        match self {
            Self::Simulated(worlds) if matches!(worlds[index], Simulated::Street(..)) => vec![base],
            _ => all.to_vec(),
        }
    }

    /// Makes one of them, with the maps its conditions need.
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

    /// In words.
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
