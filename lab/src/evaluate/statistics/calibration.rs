//! Calibration of covariances: are the errors as large as the covariances say?

use super::bootstrap::{Estimate, fraction, mean};

/// 95 % of a chi-square of 2 degrees of freedom lie below.
pub const CHI2_95_2: f64 = 5.991;
/// 95 % of a chi-square of 3 degrees of freedom lie below.
pub const CHI2_95_3: f64 = 7.815;

/// How normalised errors squared (NEES) compare with their expectation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Mean for one degree of freedom: 1 when the covariance is right, more when it is too small.
    pub mean: Estimate,
    /// Fraction of the errors inside the 95 % ellipse: 0.95 when the covariance is right.
    pub inside: Estimate,
}

/// The calibration of (normalised error squared, cluster) pairs; `None` for an empty sample.
pub fn calibration<K: Ord + Clone>(sample: &[(f64, K)], freedom: f64, chi2_95: f64) -> Option<Calibration> {
    Some(Calibration {
        mean: mean(sample.iter().map(|(nees, cluster)| (nees / freedom, cluster)))?,
        inside: fraction(sample.iter().map(|(nees, cluster)| (*nees <= chi2_95, cluster)))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn gaussian_errors_are_calibrated() {
        let seed = 3;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut square = || {
            let unit: f64 = StandardNormal.sample(&mut rng);
            unit * unit
        };
        for (freedom, chi2_95) in [(2, CHI2_95_2), (3, CHI2_95_3)] {
            let sample: Vec<(f64, usize)> =
                (0..4000).map(|k| ((0..freedom).map(|_| square()).sum(), k)).collect();
            let found = calibration(&sample, f64::from(freedom), chi2_95).unwrap();
            assert!((found.mean.value - 1.0).abs() < 0.06, "seed {seed}: {found:?}");
            assert!((found.inside.value - 0.95).abs() < 0.015, "seed {seed}: {found:?}");
        }
        assert_eq!(calibration::<u8>(&[], 2.0, CHI2_95_2), None);
    }
}
