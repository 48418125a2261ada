//! An answer and its prior as one estimate.

use nalgebra::{Matrix3, Vector3};

use super::Alignment;
use crate::pose::{Pose2, wrap_angle};

impl Alignment {
    /// This answer combined with an independent prior of the same pose: the weighted mean, and its
    /// covariance of (east m, north m, yaw rad). `None` when either covariance is not positive.
    #[must_use]
    pub fn combined(&self, prior: &Pose2, covariance: &[[f64; 3]; 3]) -> Option<Self> {
        let information = Matrix3::from(*covariance).cholesky()?.inverse();
        let own = Matrix3::from(self.covariance).cholesky()?.inverse();
        let together = (information + own).cholesky()?.inverse();
        let apart = Vector3::new(
            prior.x_m - self.pose.x_m,
            prior.y_m - self.pose.y_m,
            wrap_angle(prior.yaw_rad - self.pose.yaw_rad),
        );
        let moved = together * information * apart;
        let shifted = |pose: &Pose2| {
            Pose2::new(pose.x_m + moved[0], pose.y_m + moved[1], wrap_angle(pose.yaw_rad + moved[2]))
        };
        Some(Self {
            pose: shifted(&self.pose),
            correction: shifted(&self.correction),
            covariance: together.into(),
            ..self.clone()
        })
    }
}

/// A covariance of (east, north, yaw) after its axes were turned: what lay along an axis lies `by_rad`
/// counter-clockwise of it.
#[must_use]
pub fn turned(covariance: &[[f64; 3]; 3], by_rad: f64) -> [[f64; 3]; 3] {
    let (s, c) = by_rad.sin_cos();
    let turn = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0);
    // Both are symmetric, so it does not matter that an array's rows become columns.
    (turn * Matrix3::from(*covariance) * turn.transpose()).into()
}

/// The prior's covariance and the sigmas that a search must cover: of the position along its longest
/// axis, metres, and of the heading, radians. `None` unless the matrix is positive definite.
#[must_use]
pub fn sigmas(covariance: &[[f64; 3]; 3]) -> Option<(f64, f64)> {
    let matrix = Matrix3::from(*covariance);
    matrix.cholesky()?;
    let largest = matrix.fixed_view::<2, 2>(0, 0).symmetric_eigenvalues().max();
    Some((largest.sqrt(), matrix[(2, 2)].sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::verdict::tests::answer;

    #[test]
    fn a_turned_covariance_is_long_in_the_turned_direction() {
        let long_east = [[4.0, 0.0, 0.1], [0.0, 1.0, 0.0], [0.1, 0.0, 0.01]];
        let turned = turned(&long_east, std::f64::consts::FRAC_PI_2);
        let expected = [[1.0, 0.0, 0.0], [0.0, 4.0, 0.1], [0.0, 0.1, 0.01]];
        let off = turned.iter().flatten().zip(expected.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-12, "{turned:?}");
    }

    #[test]
    fn the_better_known_counts_for_more() {
        // Sigmas of 0.2 m and 0.1 m, against a prior of 0.1 m a metre to the east.
        let prior = Pose2::new(1.0, 0.0, 0.0);
        let known = [[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 1e-6]];
        let both = answer().combined(&prior, &known).unwrap();
        assert!((both.pose.x_m - 0.8).abs() < 1e-9 && (both.correction.x_m - 0.8).abs() < 1e-9);
        assert!((both.covariance[0][0] - 0.008).abs() < 1e-9);
        assert!((both.covariance[1][1] - 0.005).abs() < 1e-9);
        assert!(answer().combined(&prior, &[[0.0; 3]; 3]).is_none());
    }

    #[test]
    fn the_search_covers_the_longest_axis() {
        let (position, yaw) = sigmas(&[[2.5, 1.5, 0.0], [1.5, 2.5, 0.0], [0.0, 0.0, 0.01]]).unwrap();
        assert!((position - 2.0).abs() < 1e-9 && (yaw - 0.1).abs() < 1e-9);
        assert!(sigmas(&[[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_none());
    }
}
