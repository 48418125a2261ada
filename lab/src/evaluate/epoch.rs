//! The epochs at which fixes are made, and their batches and priors.

use std::collections::BTreeSet;

use echofix_core::batch::Batch;
use echofix_core::doppler::dedrift::{OdometryBias, dedrifted};
use echofix_core::doppler::ego::EgoConfig;
use echofix_core::geo::CellIndex;
use echofix_core::odometry::{OdometryQuality, Trajectory};
use echofix_core::point::{BodyPoint, MapPoint};
use echofix_core::pose::Pose2;
use echofix_harness::prior::PriorSigma;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::condition::Condition;
use super::map::Movers;
use super::method::Prior;
use super::world::EvaluationWorld;

/// Length of the longest batch, microseconds. Every epoch comes that long after the first scan, so that all batch lengths have
/// the same epochs.
const WARM_UP_US: i64 = 8_000_000;
/// Least time of driving before an epoch, microseconds. Right after a rest a batch is nearly empty, and the service would refuse
/// it.
const DRIVEN_US: i64 = 1_000_000;
/// Length of a block, microseconds. Epochs that far apart count as independent: the structure around them and the errors of the
/// map's poses have changed.
const BLOCK_US: i64 = 120_000_000;

/// A time at which every method localizes the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Epoch {
    /// Its number within the world, from 0.
    pub number: usize,
    /// Number of its block. Epochs of one block are not independent.
    pub block: usize,
    /// Time of the newest scan.
    pub time_us: i64,
    /// Whether all conditions are evaluated here, and not only those of the headline.
    pub swept: bool,
}

/// Epochs about `every_s` apart while driving, evenly thinned to `most`. All conditions are evaluated at `swept` of them.
pub fn epochs(world: &EvaluationWorld, every_s: f64, most: usize, swept: usize) -> Vec<Epoch> {
    let least_mps = Movers::Included.gate().min_speed_mps;
    let Some(first) = world.drive.scans.first() else { return Vec::new() };
    let mut next_us = first.time_us + WARM_UP_US;
    let mut times = Vec::new();
    let mut rested_us = first.time_us;
    for scan in &world.drive.scans {
        let speed = world.odometry.velocity_at(scan.time_us).map_or(0.0, |v| v.speed_mps());
        if speed <= least_mps {
            rested_us = scan.time_us;
        }
        let driven = scan.time_us - rested_us >= DRIVEN_US;
        if scan.time_us >= next_us && driven && world.truth.at(scan.time_us).is_some() {
            times.push(scan.time_us);
            next_us = scan.time_us + (every_s * 1e6) as i64;
        }
    }
    let chosen = thinned(times.len(), most);
    let of_all = |count: usize| thinned(chosen.len(), count).into_iter().collect::<BTreeSet<_>>();
    let swept = of_all(swept);
    let epoch = |(number, index): (usize, &usize)| Epoch {
        number,
        block: ((times[*index] - first.time_us) / BLOCK_US) as usize,
        time_us: times[*index],
        swept: swept.contains(&number),
    };
    chosen.iter().enumerate().map(epoch).collect()
}

/// `most` of `count` indices, evenly spread; all of them if there are no more.
fn thinned(count: usize, most: usize) -> Vec<usize> {
    if count <= most { (0..count).collect() } else { (0..most).map(|k| k * count / most).collect() }
}

/// The batch of an epoch, and the pose that its drifted trajectory leads to.
pub struct EpochBatch {
    /// The batch.
    pub batch: Batch,
    /// Number of cells that the batch occupies.
    pub cells: usize,
    /// The true pose at the oldest scan, propagated by the drifted trajectory: map metres, radians.
    pub drifted: Pose2,
}

/// The batch of an epoch under a condition; `None` where the trajectory does not cover it.
///
/// # Errors
/// When scans and odometry do not fit together.
pub fn batch_at(
    world: &EvaluationWorld,
    epoch: &Epoch,
    condition: &Condition,
    movers: Movers,
    seed: u64,
) -> anyhow::Result<Option<EpochBatch>> {
    let (scans, end_us) = (&world.drive.scans, epoch.time_us);
    let start_us = end_us - (condition.batch_s * 1e6) as i64;
    let from = scans.partition_point(|s| s.time_us <= start_us);
    let to = scans.partition_point(|s| s.time_us <= end_us);
    let trajectory = within(&world.odometry, start_us, end_us)?;
    let trajectory = match condition.drift {
        Some(drift) => drift.apply(&trajectory, seed)?,
        None => trajectory,
    };
    let (seen, mounts) = (&scans[from..to], &world.drive.mounts);
    // A method that knows movers by their radial speeds also corrects the odometry by those of standing objects.
    let corrected = match movers {
        Movers::Included => None,
        Movers::Excluded => {
            dedrifted(seen, mounts, &trajectory, &EgoConfig::default(), &OdometryBias::default())
        }
    };
    let quality = corrected.as_ref().map_or_else(OdometryQuality::default, |corrected| corrected.quality);
    let trajectory = corrected.map_or(trajectory, |corrected| corrected.trajectory);
    let (Some(truth), Some(end), Some((begin_us, begin))) =
        (world.truth.at(end_us), trajectory.at(end_us), trajectory.first())
    else {
        return Ok(None);
    };
    let mut batch = Batch::organise(seen, mounts, &trajectory, end_us, &movers.gate())?;
    batch.quality = quality;
    let drifted = match condition.drift.and_then(|_| world.truth.at(begin_us)) {
        None => truth,
        Some(start) => {
            let moved = begin.between(&end);
            start.compose(&Pose2::new(world.scale * moved.x_m, world.scale * moved.y_m, moved.yaw_rad))
        }
    };
    let cells = occupied(&batch);
    Ok(Some(EpochBatch { batch, cells, drifted }))
}

fn occupied(batch: &Batch) -> usize {
    // Cells of the body's own plane.
    let plane = |p: &BodyPoint| MapPoint::new(p.x_m.into(), p.y_m.into());
    let cells: BTreeSet<_> = batch.points.iter().map(|p| CellIndex::of(plane(p))).collect();
    cells.len()
}

/// The part of a trajectory from the last pose before `start_us` to the first one after `end_us`.
pub fn within(all: &Trajectory, start_us: i64, end_us: i64) -> anyhow::Result<Trajectory> {
    let mut part = Trajectory::default();
    let mut before = None;
    for (time_us, pose) in all.iter() {
        if time_us <= start_us {
            before = Some((time_us, pose));
            continue;
        }
        if let Some((time_us, pose)) = before.take() {
            part.push(time_us, pose)?;
        }
        part.push(time_us, pose)?;
        if time_us >= end_us {
            break;
        }
    }
    Ok(part)
}

/// A pose with an error drawn from [`PriorSigma::PAPER`], as the prior of an alignment.
pub fn prior(around: &Pose2, scale: f64, seed: u64) -> Prior {
    let PriorSigma { position_m: sigma_position_m, yaw_rad: sigma_yaw_rad } = PriorSigma::PAPER;
    let pose = PriorSigma::PAPER.drawn_around(around, &mut ChaCha8Rng::seed_from_u64(seed));
    Prior { pose, sigma_position_m, sigma_yaw_rad, scale }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn thinning_keeps_the_spread() {
        assert_eq!(thinned(3, 5), [0, 1, 2]);
        assert_eq!(thinned(10, 3), [0, 3, 6]);
        assert!(thinned(0, 3).is_empty() && thinned(9, 0).is_empty());
    }

    #[test]
    fn a_part_of_a_trajectory_covers_its_ends() {
        let all = Trajectory::new((0..10).map(|t| (100 * t, Pose2::new(t as f64, 0.0, 0.0)))).unwrap();
        let part = within(&all, 250, 620).unwrap();
        assert_eq!((part.first().unwrap().0, part.last().unwrap().0), (200, 700));
        assert!((part.at(620).unwrap().x_m - 6.2).abs() < 1e-9);
    }

    /// Catches: draws in another order or from another sigma, which would change every published figure.
    #[test]
    fn priors_are_those_of_the_published_figures_to_the_bit() {
        let around = Pose2::new(621_000.25, 3_349_000.5, 0.7);
        for seed in 0..1000 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let (x_m, y_m) = (around.x_m + 2.0 * normal(), around.y_m + 2.0 * normal());
            let expected = Pose2::new(x_m, y_m, around.yaw_rad + 3_f64.to_radians() * normal());
            let drawn = prior(&around, 0.9996, seed);
            assert_eq!(drawn.pose, expected, "seed {seed}");
            assert_eq!((drawn.sigma_position_m, drawn.sigma_yaw_rad), (2.0, 3_f64.to_radians()));
        }
    }
}
