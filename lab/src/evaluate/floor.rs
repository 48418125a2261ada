//! The map's own error, the floor of every method's error: the errors of the poses that the map was made from.

use echofix_core::drive::Drive;
use echofix_core::geo::Grid;
use echofix_core::pose::{Pose2, wrap_angle};

use super::map::on_grid;

/// Poses of the mapping vehicle within this distance of a fix contribute to its map window, metres.
const NEAR_M: f64 = 50.0;
/// One pose in so many is enough, because their errors vary slowly.
const STEP: usize = 10;

/// True poses of the mapping drives, and the errors of the reference poses there, by contributor; empty where the truth is not
/// known.
pub struct Floor {
    contributors: Vec<Vec<(Pose2, Pose2)>>,
}

impl Floor {
    /// The errors of the mapping drives' reference poses.
    ///
    /// # Errors
    /// When a pose is off the grid.
    pub fn of(grid: &Grid, mapping: &[Drive]) -> anyhow::Result<Self> {
        let errors = |drive: &Drive| -> anyhow::Result<Vec<(Pose2, Pose2)>> {
            let (believed, truth) = (on_grid(grid, &drive.reference)?, on_grid(grid, &drive.truth)?);
            let error = |(time_us, b): (i64, Pose2)| {
                let t = truth.at(time_us)?;
                Some((t, Pose2::new(b.x_m - t.x_m, b.y_m - t.y_m, wrap_angle(b.yaw_rad - t.yaw_rad))))
            };
            Ok(believed.iter().step_by(STEP).filter_map(error).collect())
        };
        Ok(Self { contributors: mapping.iter().map(errors).collect::<anyhow::Result<_>>()? })
    }

    /// Mean error of the poses from which the first so many contributors saw the surroundings of `pose`: metres east and north,
    /// radians. `None` where it is not known.
    pub fn around(&self, pose: &Pose2, contributors: usize) -> Option<Pose2> {
        let mut sum = [0.0; 3];
        let mut count = 0.0;
        for errors in self.contributors.iter().take(contributors) {
            let near: Vec<_> = errors.iter().filter(|(at, _)| at.distance_m(pose) < NEAR_M).collect();
            if near.is_empty() {
                continue;
            }
            let mean = |part: fn(&Pose2) -> f64| {
                near.iter().map(|(_, error)| part(error)).sum::<f64>() / near.len() as f64
            };
            for (sum, part) in sum.iter_mut().zip([mean(|e| e.x_m), mean(|e| e.y_m), mean(|e| e.yaw_rad)]) {
                *sum += part;
            }
            count += 1.0;
        }
        (count > 0.0).then(|| Pose2::new(sum[0] / count, sum[1] / count, sum[2] / count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contributors_count_alike_and_only_where_they_were() {
        let at = |x_m: f64, error_m: f64| (Pose2::new(x_m, 0.0, 0.0), Pose2::new(error_m, 0.0, 0.01));
        let floor = Floor {
            contributors: vec![vec![at(0.0, 0.2), at(10.0, 0.4), at(500.0, 9.0)], vec![at(5.0, -0.1)]],
        };
        let here = Pose2::new(3.0, 0.0, 1.0);
        assert!((floor.around(&here, 1).unwrap().x_m - 0.3).abs() < 1e-12);
        assert!((floor.around(&here, 2).unwrap().x_m - 0.1).abs() < 1e-12);
        assert!((floor.around(&here, 2).unwrap().yaw_rad - 0.01).abs() < 1e-12);
        assert_eq!(floor.around(&Pose2::new(-300.0, 0.0, 0.0), 2), None);
    }
}
