//! What errors of the mounts and clocks do to the answer.
//!
//! A radar that is turned, moved or late displaces each of its points in its own way. The alignment answers with the
//! rigid motion that fits the displaced points best, so an error's effect on the answer is the least-squares rigid
//! motion of the displacements: a late clock moves the answer back along the way, a turned mount moves it sideways
//! and turns it, by how far ahead and how widely the points lie. Errors that radars do not share average out as far as
//! the points are shared among them.

use nalgebra::{Matrix3, Matrix3x4, Vector3};

use crate::batch::{Batch, OwnError};
use crate::odometry::Trajectory;
use crate::point::BodyPoint;
use crate::pose::Pose2;
use crate::scan::Mount;

/// How well a radar's clock and mount are known: one-sigma errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MountSigma {
    /// Of the scans' times against odometry's clock, seconds; taken as common to all radars.
    pub time_s: f64,
    /// Of the position along each axis, metres; half of the variance is taken as common.
    pub position_m: f64,
    /// Of the boresight, radians; half of the variance is taken as common.
    pub yaw_rad: f64,
}

impl Default for MountSigma {
    /// A car whose radars were calibrated in the works and are synchronised: what the contract takes where a caller is
    /// silent.
    fn default() -> Self {
        Self { time_s: 0.005, position_m: 0.02, yaw_rad: 0.2_f64.to_radians() }
    }
}

impl MountSigma {
    /// Nothing is off.
    pub const NONE: Self = Self { time_s: 0.0, position_m: 0.0, yaw_rad: 0.0 };

    /// (late, yaw, forward, left).
    fn sigmas(&self) -> [f64; 4] {
        [self.time_s, self.yaw_rad, self.position_m, self.position_m]
    }
}

/// The part of each variance that all radars share: (late, yaw, forward, left).
const COMMON: [f64; 4] = [1.0, 0.5, 0.5, 0.5];

/// The errors of an answer to a batch, from the errors of each radar; a radar without any declared has the default's.
///
/// `odometry` and `mounts` are those the batch was organised by.
#[must_use]
pub fn own_error(
    batch: &Batch,
    odometry: &Trajectory,
    reference_time_us: i64,
    mounts: &[Mount],
    sigmas: &[MountSigma],
) -> OwnError {
    let Some(inverse) = rigid_information(&batch.points).try_inverse() else { return OwnError::default() };
    let mut radars = vec![Matrix3x4::zeros(); mounts.len()];
    let ends = batch.sightings.iter().skip(1).map(|s| s.first).chain([batch.points.len()]);
    for (sighting, end) in batch.sightings.iter().zip(ends) {
        let (Some(mount), Some(points)) =
            (mounts.get(sighting.sensor), batch.points.get(sighting.first..end))
        else {
            continue;
        };
        let velocity = odometry.velocity_at(reference_time_us - (sighting.age_s * 1e6).round() as i64);
        let velocity = velocity.unwrap_or_default();
        let (s, c) = sighting.body.yaw_rad.sin_cos();
        let along = [
            c * velocity.forward_mps - s * velocity.left_mps,
            s * velocity.forward_mps + c * velocity.left_mps,
        ];
        let sensor = sighting.body.compose(mount);
        let sums = PointSums::of(points);
        let columns = [
            sums.pushed(along) + sums.turned(&sighting.body) * velocity.yaw_rate_radps,
            sums.turned(&sensor),
            sums.pushed([c, s]),
            sums.pushed([-s, c]),
        ];
        radars[sighting.sensor] += inverse * Matrix3x4::from_columns(&columns);
    }
    OwnError(combined(&radars, sigmas).into())
}

/// The covariance of all radars' effects: what they share adds up, what they do not is independent.
fn combined(radars: &[Matrix3x4<f64>], sigmas: &[MountSigma]) -> Matrix3<f64> {
    let mut covariance = Matrix3::zeros();
    for (error, common) in COMMON.into_iter().enumerate() {
        let mut shared = Vector3::zeros();
        for (radar, effect) in radars.iter().enumerate() {
            let sigma = sigmas.get(radar).copied().unwrap_or_default().sigmas()[error];
            let effect = effect.column(error) * sigma;
            shared += effect * common.sqrt();
            covariance += effect * effect.transpose() * (1.0 - common);
        }
        covariance += shared * shared.transpose();
    }
    covariance
}

/// How firmly points hold a rigid motion about the origin.
fn rigid_information(points: &[BodyPoint]) -> Matrix3<f64> {
    let PointSums { count, x, y, squares } = PointSums::of(points);
    Matrix3::new(count, 0.0, -y, 0.0, count, x, -y, x, squares)
}

/// Sums over points: how many, where, and how far from the origin.
struct PointSums {
    count: f64,
    x: f64,
    y: f64,
    squares: f64,
}

impl PointSums {
    fn of(points: &[BodyPoint]) -> Self {
        let mut sums = Self { count: points.len() as f64, x: 0.0, y: 0.0, squares: 0.0 };
        for point in points {
            let (x, y) = (f64::from(point.x_m), f64::from(point.y_m));
            sums.x += x;
            sums.y += y;
            sums.squares += x * x + y * y;
        }
        sums
    }

    /// The right side for points that are all pushed one way.
    fn pushed(&self, [dx, dy]: [f64; 2]) -> Vector3<f64> {
        Vector3::new(self.count * dx, self.count * dy, self.x * dy - self.y * dx)
    }

    /// The right side for points that turn about a place, a radian of it.
    fn turned(&self, about: &Pose2) -> Vector3<f64> {
        let (x, y) = (self.x - self.count * about.x_m, self.y - self.count * about.y_m);
        Vector3::new(-y, x, self.squares - self.x * about.x_m - self.y * about.y_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::Sighting;

    /// Two radars at the nose, one to each side, that see a square all around, ten times on the way.
    fn batch(speed_mps: f64, yaw_rate_radps: f64) -> (Batch, Trajectory, [Mount; 2]) {
        let mut pose = Pose2::IDENTITY;
        let mut poses = vec![(0, pose)];
        for i in 1..=50 {
            pose = pose.compose(&Pose2::new(0.1 * speed_mps, 0.0, 0.1 * yaw_rate_radps));
            poses.push((i * 100_000, pose));
        }
        let odometry = Trajectory::new(poses).unwrap();
        let mut batch = Batch::default();
        for (scan, sensor) in (5..=50).step_by(5).flat_map(|scan| [(scan, 0), (scan, 1)]) {
            let body = pose.between(&odometry.at(scan * 100_000).unwrap());
            let (first, age_s) = (batch.points.len(), (50 - scan) as f64 * 0.1);
            batch.sightings.push(Sighting { first, age_s, body, sensor });
            for [x, y] in
                [[20.0, 10.0], [20.0, -10.0], [40.0, 10.0], [40.0, -10.0], [5.0, 12.0], [5.0, -12.0]]
            {
                let [x, y] = body.transform([x, y]);
                batch.points.push(BodyPoint { x_m: x as f32, y_m: y as f32 });
            }
        }
        (batch, odometry, [Mount::new(3.5, 0.7, 0.5), Mount::new(3.5, -0.7, -0.5)])
    }

    fn sigma(speed_mps: f64, yaw_rate_radps: f64, sigmas: [MountSigma; 2]) -> [f64; 3] {
        let (batch, odometry, mounts) = batch(speed_mps, yaw_rate_radps);
        let OwnError(covariance) = own_error(&batch, &odometry, 5_000_000, &mounts, &sigmas);
        [0, 1, 2].map(|axis| covariance[axis][axis].sqrt())
    }

    /// Catches: a late clock that is in the levels per radar, as if each had a clock of its own.
    #[test]
    fn a_clock_moves_the_answer_along_by_the_speed_and_turns_it_by_the_turn() {
        let late = MountSigma { time_s: 0.02, ..MountSigma::NONE };
        let [along, across, yaw] = sigma(10.0, 0.0, [late; 2]);
        assert!((along - 0.2).abs() < 1e-3 && across < 1e-3 && yaw < 1e-4, "{along} {across} {yaw}");
        // On a circle the answer is the pose at another time of it.
        let [along, across, yaw] = sigma(10.0, 0.3, [late; 2]);
        assert!((along - 0.2).abs() < 5e-3 && across < 5e-3, "{along} {across}");
        assert!((yaw - 0.006).abs() < 2e-4, "{yaw}");
    }

    /// Catches: errors of single radars that do not average, or common ones that do.
    #[test]
    fn a_shift_of_all_radars_moves_the_answer_and_one_radars_half_of_it() {
        let off = MountSigma { position_m: 0.1, ..MountSigma::NONE };
        let [along, across, _] = sigma(8.0, 0.0, [off; 2]);
        // Half of the variance is common; of the other half each radar's is halved, and there are two.
        let expected = 0.1 * (0.5_f64 + 0.5 * 0.5).sqrt();
        assert!((along - expected).abs() < 1e-3 && (across - expected).abs() < 2e-2, "{along} {across}");
        let [one, _, _] = sigma(8.0, 0.0, [off, MountSigma::NONE]);
        assert!((one - 0.05).abs() < 1e-3, "{one}");
    }

    /// Catches: a turn of the mounts that is taken for a turn of the answer alone.
    #[test]
    fn turned_mounts_turn_the_answer_and_move_it_aside() {
        let turned = MountSigma { yaw_rad: 1_f64.to_radians(), ..MountSigma::NONE };
        let [along, across, yaw] = sigma(8.0, 0.0, [turned; 2]);
        assert!(along < 0.02 && across > 0.1, "{along} {across}");
        assert!(yaw > 0.3_f64.to_radians() && yaw < 1_f64.to_radians(), "{yaw}");
    }

    #[test]
    fn nothing_is_off_where_nothing_is_said_to_be() {
        assert!(sigma(8.0, 0.1, [MountSigma::NONE; 2]).iter().all(|sigma| sigma.abs() < 1e-12));
        let (batch, odometry) = (Batch::default(), Trajectory::default());
        let none = own_error(&batch, &odometry, 0, &[Mount::IDENTITY], &[MountSigma::default()]);
        assert_eq!(none, OwnError::default());
    }
}
