//! Poses that no vehicle can have: a few in a row that lie elsewhere than those around them, as receivers tell that lost their way.

use super::{Flaws, Problem};

/// Faster than this nobody drives, metres per second.
const FASTEST_MPS: f64 = 150.0;
/// Jumps up to this are noise, metres.
const NOISE_M: f64 = 10.0;
/// So many poses in a row are a place of their own: odometry may begin anew.
const PLACE: usize = 10;

/// Poses in order of time as (time in microseconds, place in the part, pose), without a few that lie elsewhere than those around them;
/// these are counted in `flaws` under `part`. `is_nowhere` says of which it is known that they are none, however many there are.
pub(super) fn without_jumps<T>(
    poses: Vec<(i64, u64, T)>,
    part: &str,
    flaws: &mut Flaws,
    distance_m: impl Fn(&T, &T) -> f64,
    is_nowhere: impl Fn(&T) -> bool,
) -> Vec<(i64, T)> {
    let beside = |a: &(i64, u64, T), b: &(i64, u64, T)| {
        let seconds = b.0.saturating_sub(a.0) as f64 * 1e-6;
        distance_m(&a.2, &b.2) <= NOISE_M + FASTEST_MPS * seconds
    };
    let stays = |run: &[(i64, u64, T)]| run.len() >= PLACE && !run.iter().all(|pose| is_nowhere(&pose.2));
    let runs: Vec<&[(i64, u64, T)]> = poses.chunk_by(beside).collect();
    let mut keep = Vec::with_capacity(poses.len());
    if runs.iter().any(|run| stays(run)) {
        for run in runs {
            let stay = stays(run);
            keep.extend(std::iter::repeat_n(stay, run.len()));
        }
    } else {
        keep.resize(poses.len(), true);
    }
    let kept = poses.into_iter().zip(keep).filter_map(|((time_us, place, pose), keep)| {
        if !keep {
            flaws.skip(part, place, &Problem::Elsewhere);
        }
        keep.then_some((time_us, pose))
    });
    kept.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Poses along a line, 50 ms apart, without those that jump; and how many of these were told.
    fn left(along_m: &[f64]) -> (Vec<f64>, u64) {
        let mut flaws = Flaws::default();
        let poses = (0..).zip(along_m).map(|(i, m)| (50_000 * i, i as u64 + 2, *m)).collect();
        let kept = without_jumps(poses, "odometry.csv", &mut flaws, |a, b| (a - b).abs(), |m| *m == 0.0);
        (kept.into_iter().map(|(_, m)| m).collect(), flaws.count("elsewhere"))
    }

    /// Catches: one pose of a receiver that lost its way, which takes the scans around it along or away; and odometry that begins
    /// anew, a short log and a hole that are taken for such.
    #[test]
    fn a_few_poses_elsewhere_are_skipped_and_told() {
        let drive: Vec<f64> = (1..100).map(f64::from).collect();
        for (at, bad) in [(0, 1), (50, 1), (50, 9), (98, 1)] {
            let mut along = drive.clone();
            along[at..at + bad].fill(1e5);
            let good: Vec<f64> = along.iter().copied().filter(|m| *m < 1e5).collect();
            assert_eq!(left(&along), (good, bad as u64), "{bad} at {at}");
        }
        let mut lost = drive.clone();
        for m in &mut lost {
            *m += 1e4;
        }
        lost[20..60].fill(0.0);
        assert_eq!(left(&lost).1, 40, "a receiver that knows no place says 0");
        let anew: Vec<f64> = drive.iter().copied().chain((1..100).map(|m| 1e6 + f64::from(m))).collect();
        assert_eq!(left(&anew), (anew, 0));
        assert_eq!(left(&[1.0, 1e6, 2.0]).1, 0);
    }
}
