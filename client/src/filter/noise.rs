//! What part of a fix's error is whose.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::config::FixNoise;

/// The part of a variance that is independent from fix to fix: one sigma, metres and radians. Small
/// against any fix; it keeps matrices invertible.
const FRESH_SIGMA: [f64; 3] = [0.01, 0.01, 2e-4];
/// The most of a fix's variance that is put down to the map.
const MAP_FRACTION: f64 = 0.9;

/// A fix's covariance, split: `map * map^T * V + batch * batch^T + fresh`, with `V` the variances of
/// the map's own error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Split {
    /// Fraction of the map's own error in each component: 1, or less where the fix is known better
    /// than the map is said to be.
    pub(super) map: Vector3<f64>,
    /// A root of what the fixes of overlapping batches have in common, metres and radians per
    /// unit.
    pub(super) batch: Matrix3<f64>,
    /// Variances of what is this fix's alone.
    pub(super) fresh: Matrix3<f64>,
}

impl Split {
    /// Splits a positive semidefinite covariance.
    ///
    /// The parts sum up to the fix's own covariance: a split only says which part of its error the next fix
    /// has, too. The map's part is taken from what the rest of the matrix does not explain, so that what is
    /// left stays a covariance.
    pub(super) fn of(covariance: &Matrix3<f64>, noise: &FixNoise) -> Self {
        let fresh = Matrix3::from_diagonal(&Vector3::from(FRESH_SIGMA.map(|s| s * s)));
        // Positive definite from here on.
        let mut left = covariance + fresh;
        let position = left.fixed_view::<2, 2>(0, 0).into_owned();
        let lever: Vector2<f64> = left.fixed_view::<2, 1>(0, 2).into_owned();
        let map_m2 = fraction(smallest(&(position - lever * lever.transpose() / left[(2, 2)])), noise.map_m);
        left[(0, 0)] -= map_m2 * noise.map_m.powi(2);
        left[(1, 1)] -= map_m2 * noise.map_m.powi(2);
        let position = left.fixed_view::<2, 2>(0, 0).into_owned();
        let explained = position.try_inverse().map_or(0.0, |p| lever.dot(&(p * lever)));
        let map_rad2 = fraction(left[(2, 2)] - explained, noise.map_rad);
        left[(2, 2)] -= map_rad2 * noise.map_rad.powi(2);
        let map = Vector3::new(map_m2.sqrt(), map_m2.sqrt(), map_rad2.sqrt());
        Self { map, batch: root(&left), fresh }
    }
}

/// How much of the map's variance fits into a variance.
fn fraction(variance: f64, map_sigma: f64) -> f64 {
    if map_sigma > 0.0 { (MAP_FRACTION * variance.max(0.0) / map_sigma.powi(2)).min(1.0) } else { 0.0 }
}

/// The smaller eigenvalue.
fn smallest(m: &Matrix2<f64>) -> f64 {
    0.5 * (m[(0, 0)] + m[(1, 1)]) - (0.5 * (m[(0, 0)] - m[(1, 1)])).hypot(m[(0, 1)])
}

/// The root that is symmetric once every component is counted in its own sigmas: of all roots the
/// one under which two fixes of like, but turned error ellipses err alike.
fn root(covariance: &Matrix3<f64>) -> Matrix3<f64> {
    let sigma = covariance.diagonal().map(|v| v.max(0.0).sqrt().max(f64::MIN_POSITIVE));
    let correlation = Matrix3::from_fn(|i, j| covariance[(i, j)] / (sigma[i] * sigma[j]));
    let eigen = correlation.symmetric_eigen();
    let roots = Matrix3::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    Matrix3::from_diagonal(&sigma) * eigen.eigenvectors * roots * eigen.eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn whole(split: &Split, noise: &FixNoise) -> Matrix3<f64> {
        let map = Vector3::new(noise.map_m, noise.map_m, noise.map_rad).component_mul(&split.map);
        Matrix3::from_diagonal(&map.component_mul(&map)) + split.batch * split.batch.transpose() + split.fresh
    }

    #[test]
    fn the_map_s_part_is_taken_out_once() {
        let noise = FixNoise::default();
        let covariance = Matrix3::from_diagonal(&Vector3::new(0.0164, 0.0164, 5e-6));
        let split = Split::of(&covariance, &noise);
        assert!((split.map - Vector3::repeat(1.0)).norm() < 1e-12, "{}", split.map);
        assert!((split.batch[(0, 0)].powi(2) - 0.0065).abs() < 1e-9, "{}", split.batch);
    }

    proptest! {
        #[test]
        fn the_parts_make_the_whole(entries in proptest::array::uniform9(-1.0..1.0_f64), scale in -4.0..1.0_f64) {
            let factor = Matrix3::from_row_slice(&entries) * 10_f64.powf(scale);
            let units = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.03));
            let covariance = units * factor * factor.transpose() * units;
            let noise = FixNoise::default();
            let split = Split::of(&covariance, &noise);
            let error = whole(&split, &noise) - covariance - 2.0 * split.fresh;
            prop_assert!(error.norm() < 1e-9 * (1.0 + covariance.norm()), "{error}");
            prop_assert!(split.map.iter().all(|fraction| (0.0..=1.0).contains(fraction)), "{}", split.map);
        }
    }
}
