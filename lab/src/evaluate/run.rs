//! Localizes the vehicle with every method at every epoch, under every condition.

use std::collections::BTreeMap;
use std::sync::Arc;

use indicatif::ProgressBar;
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::condition::Condition;
use super::epoch::{Epoch, EpochBatch, ask, epochs, prior};
use super::localizability::Forecaster;
use super::map::Movers;
use super::method::{Method, MethodName, Windows};
use super::record::{EpochRecord, Facts};
use super::world::EvaluationWorld;

/// What is evaluated.
#[derive(Debug, Clone, PartialEq)]
pub struct EvaluationPlan {
    /// Time between epochs, seconds of driving.
    pub every_s: f64,
    /// Largest number of epochs in a world.
    pub epochs: usize,
    /// Number of these epochs at which all conditions are evaluated, and not only those of the headline.
    pub swept: usize,
    /// The conditions of the headline.
    pub base: Condition,
    /// Random priors at each epoch.
    pub priors: usize,
    /// Seed of the priors and of the odometry's drift.
    pub seed: u64,
    /// The methods, in the order of the tables.
    pub methods: Vec<MethodName>,
    /// Further methods, and the conditions under which they are evaluated, at swept epochs only.
    pub variants: Vec<(MethodName, Condition)>,
    /// Whether fixes are also predicted from the map alone.
    pub forecasts: bool,
}

impl EvaluationPlan {
    /// All methods, each once.
    fn all_methods(&self) -> Vec<MethodName> {
        let mut all = self.methods.clone();
        for (name, _) in &self.variants {
            if !all.contains(name) {
                all.push(*name);
            }
        }
        all
    }

    /// All methods with their names, for one thread.
    fn ready(&self, windows: &Arc<Windows>) -> Vec<(MethodName, Box<dyn Method>)> {
        self.all_methods().into_iter().map(|name| (name, name.method(windows))).collect()
    }

    /// Whether a method is evaluated under a condition at an epoch.
    fn asks(&self, name: MethodName, condition: &Condition, epoch: &Epoch) -> bool {
        let variant = || self.variants.iter().any(|(n, c)| *n == name && c == condition);
        self.methods.contains(&name) || (epoch.swept && variant())
    }
}

/// The fixes of every method at a world's epochs, in order of epoch, condition, prior and method.
///
/// # Errors
/// When the world's drives do not fit together.
pub fn run(
    world: &EvaluationWorld,
    conditions: &[Condition],
    plan: &EvaluationPlan,
    windows: &Arc<Windows>,
    bar: &ProgressBar,
) -> anyhow::Result<Vec<EpochRecord>> {
    let epochs = epochs(world, plan.every_s, plan.epochs, plan.swept);
    bar.inc_length(epochs.len() as u64);
    let rows = epochs.par_iter().map_init(
        || (plan.ready(windows), plan.forecasts.then(|| Forecaster::new(windows))),
        |(methods, forecaster), epoch| {
            let mut rows = at_epoch(world, epoch, conditions, plan, methods)?;
            if let Some(forecaster) = forecaster {
                forecaster.add(world, epoch, &plan.base, &mut rows)?;
            }
            bar.inc(1);
            Ok(rows)
        },
    );
    let rows: Vec<Vec<EpochRecord>> = rows.collect::<anyhow::Result<_>>()?;
    Ok(rows.into_iter().flatten().collect())
}

fn at_epoch(
    world: &EvaluationWorld,
    epoch: &Epoch,
    conditions: &[Condition],
    plan: &EvaluationPlan,
    methods: &mut [(MethodName, Box<dyn Method>)],
) -> anyhow::Result<Vec<EpochRecord>> {
    let seed = seed_of(plan.seed, world.index, epoch.number);
    let mut rows = Vec::new();
    for condition in conditions {
        if !epoch.swept && *condition != plan.base {
            continue;
        }
        let mut batches = BTreeMap::new();
        for movers in [Movers::Included, Movers::Excluded] {
            if let Some(asked) = ask(world, epoch, condition, movers, seed)? {
                batches.insert(movers, asked);
            }
        }
        for number in 0..plan.priors {
            for (name, method) in &mut *methods {
                if !plan.asks(*name, condition, epoch) {
                    continue;
                }
                if let Some(asked) = batches.get(&method.movers()) {
                    rows.push(fix(world, epoch, condition, asked, (number, seed), &mut **method)?);
                }
            }
        }
    }
    Ok(rows)
}

/// The fix of one method, beside the truth.
fn fix(
    world: &EvaluationWorld,
    epoch: &Epoch,
    condition: &Condition,
    asked: &EpochBatch,
    (number, seed): (usize, u64),
    method: &mut dyn Method,
) -> anyhow::Result<EpochRecord> {
    let EpochBatch { batch, cells, drifted } = asked;
    let Some(truth) = world.truth.at(epoch.time_us) else { anyhow::bail!("the truth ends within the drive") };
    // The priors of all conditions and methods have the same errors, around the pose that the batch leads to.
    let prior = prior(drifted, world.scale, seed.wrapping_add(number as u64));
    let outcome = method.fix(world.map(condition.contributors, method.movers())?, batch, &prior);
    let floor = world.floor.around(&truth, condition.contributors);
    let reference = world.reference.at(epoch.time_us);
    let facts = Facts { truth, reference, drifted: *drifted, scale: world.scale, floor };
    let row = EpochRecord {
        site_kind: world.site_kind,
        world: world.name.clone(),
        epoch: epoch.number,
        block: epoch.block,
        time_us: epoch.time_us,
        prior: number,
        condition: *condition,
        batch_s: condition.batch_s,
        drift_m: condition.drift.map_or(0.0, |d| d.sigma_position_m),
        drift_deg: condition.drift.map_or(0.0, |d| d.sigma_yaw_rad.to_degrees()),
        growth: condition.growth(),
        contributors: condition.contributors,
        swept: epoch.swept,
        method: method.name(),
        speed_mps: batch.speed_mps,
        points: batch.points.len(),
        cells: *cells,
        ..EpochRecord::default()
    };
    Ok(row.answered(&outcome, &facts))
}

/// A different seed for every epoch of every world.
fn seed_of(seed: u64, world: usize, epoch: usize) -> u64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(((world as u64) << 32) | epoch as u64);
    rng.random()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_differ_by_world_and_epoch_and_repeat() {
        let all = [(1, 0, 0), (2, 0, 0), (1, 1, 0), (1, 0, 1)].map(|(s, w, e)| seed_of(s, w, e));
        for (k, seed) in all.iter().enumerate() {
            assert!(all[..k].iter().all(|other| other != seed));
        }
        assert_eq!(seed_of(1, 0, 1), all[3]);
    }
}
