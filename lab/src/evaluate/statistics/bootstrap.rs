//! Percentiles, means and fractions with bootstrap confidence intervals. The bootstrap draws whole clusters, because epochs that
//! are near in time are not independent.
//!
//! The percentiles are weighted nearest ranks, and not those of `echofix_harness::percentiles`: a draw changes only how often
//! each cluster counts, so that the sample is sorted once, and not once for each of the 1000 draws.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// Number of draws.
const DRAWS: usize = 1000;
const SEED: u64 = 1;

/// With fewer clusters than this, no interval is given.
const LEAST_CLUSTERS: usize = 5;

/// A figure with its 95 % confidence interval, which is NaN when there are too few clusters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The figure of the whole sample.
    pub value: f64,
    /// 2.5 % of the draws are below.
    pub low: f64,
    /// 2.5 % of the draws are above.
    pub high: f64,
}

/// The draws: how often each cluster counts.
struct Draws {
    rng: ChaCha8Rng,
    weights: Vec<u32>,
}

impl Draws {
    fn of(clusters: usize) -> Self {
        Self { rng: ChaCha8Rng::seed_from_u64(SEED), weights: vec![0; clusters] }
    }

    fn next(&mut self) -> &[u32] {
        self.weights.fill(0);
        for _ in 0..self.weights.len() {
            let drawn = self.rng.random_range(0..self.weights.len());
            self.weights[drawn] += 1;
        }
        &self.weights
    }
}

/// Percentiles by the nearest rank of (value, cluster) pairs, one for each of `fractions`; empty for an empty sample.
pub fn percentiles<K: Ord>(sample: impl IntoIterator<Item = (f64, K)>, fractions: &[f64]) -> Vec<Estimate> {
    let (sorted, clusters) = numbered(sample);
    if sorted.is_empty() {
        return Vec::new();
    }
    let values = at_fractions(&sorted, &vec![1; clusters], fractions);
    let mut draws = Draws::of(clusters);
    let mut drawn: Vec<Vec<f64>> = vec![Vec::with_capacity(DRAWS); fractions.len()];
    for _ in 0..DRAWS {
        for (all, value) in drawn.iter_mut().zip(at_fractions(&sorted, draws.next(), fractions)) {
            all.push(value);
        }
    }
    values.into_iter().zip(drawn).map(|(value, drawn)| estimate(value, drawn, clusters)).collect()
}

/// Ratios of two samples, given as ((value, other), cluster) rows: of their percentiles at `fraction`, and of their root mean
/// squares. `None` for an empty sample. Both values of a row are drawn together, so that what they have in common cancels.
pub fn ratios<K: Ord>(rows: &[((f64, f64), K)], fraction: f64) -> Option<[Estimate; 2]> {
    let of =
        |value: fn(&(f64, f64)) -> f64| numbered(rows.iter().map(|(pair, cluster)| (value(pair), cluster)));
    let ((ours, clusters), (others, _)) = (of(|pair| pair.0), of(|pair| pair.1));
    let figures = |sorted: &[(f64, usize)], weights: &[u32]| {
        let squares = sorted.iter().map(|(v, cluster)| f64::from(weights[*cluster]) * v * v);
        [at_fractions(sorted, weights, &[fraction])[0], squares.sum::<f64>().sqrt()]
    };
    let compared = |weights: &[u32]| {
        let (a, b) = (figures(&ours, weights), figures(&others, weights));
        [a[0] / b[0], a[1] / b[1]]
    };
    if rows.is_empty() {
        return None;
    }
    let mut draws = Draws::of(clusters);
    let drawn: Vec<_> = (0..DRAWS).map(|_| compared(draws.next())).collect();
    let value = compared(&vec![1; clusters]);
    Some([0, 1].map(|k| estimate(value[k], drawn.iter().map(|d| d[k]).collect(), clusters)))
}

/// The fraction of (hit, cluster) pairs that are hits; `None` for an empty sample.
pub fn fraction<K: Ord>(sample: impl IntoIterator<Item = (bool, K)>) -> Option<Estimate> {
    mean(sample.into_iter().map(|(hit, cluster)| (f64::from(u8::from(hit)), cluster)))
}

/// The mean of (value, cluster) pairs; `None` for an empty sample.
pub fn mean<K: Ord>(sample: impl IntoIterator<Item = (f64, K)>) -> Option<Estimate> {
    let (sorted, clusters) = numbered(sample);
    let mut sums = vec![(0.0, 0.0); clusters];
    for (value, cluster) in sorted {
        sums[cluster].0 += value;
        sums[cluster].1 += 1.0;
    }
    let of = |weights: &[u32]| {
        let (mut sum, mut count) = (0.0, 0.0);
        for ((s, n), w) in sums.iter().zip(weights) {
            sum += f64::from(*w) * s;
            count += f64::from(*w) * n;
        }
        sum / count
    };
    let mut draws = Draws::of(clusters);
    let mut drawn = || (0..DRAWS).map(|_| of(draws.next())).collect();
    (clusters > 0).then(|| estimate(of(&vec![1; clusters]), drawn(), clusters))
}

/// The values in ascending order with the numbers of their clusters, and the number of clusters.
fn numbered<K: Ord>(sample: impl IntoIterator<Item = (f64, K)>) -> (Vec<(f64, usize)>, usize) {
    let sample: Vec<_> = sample.into_iter().collect();
    let mut numbers: BTreeMap<&K, usize> = BTreeMap::new();
    for (_, cluster) in &sample {
        let next = numbers.len();
        numbers.entry(cluster).or_insert(next);
    }
    let mut sorted: Vec<_> = sample.iter().map(|(value, cluster)| (*value, numbers[cluster])).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    (sorted, numbers.len())
}

/// Percentiles by the nearest rank, where each cluster counts as often as its weight says. The sample is ascending.
fn at_fractions(sorted: &[(f64, usize)], weights: &[u32], fractions: &[f64]) -> Vec<f64> {
    let total: u64 = sorted.iter().map(|(_, cluster)| u64::from(weights[*cluster])).sum();
    let rank = |fraction: f64| ((fraction * total as f64).ceil() as u64).max(1);
    let mut values = Vec::with_capacity(fractions.len());
    let mut passed = 0;
    for (value, cluster) in sorted {
        passed += u64::from(weights[*cluster]);
        while values.len() < fractions.len() && passed >= rank(fractions[values.len()]) {
            values.push(*value);
        }
    }
    values
}

fn estimate(value: f64, mut drawn: Vec<f64>, clusters: usize) -> Estimate {
    if clusters < LEAST_CLUSTERS {
        return Estimate { value, low: f64::NAN, high: f64::NAN };
    }
    drawn.sort_by(f64::total_cmp);
    let at = |fraction: f64| drawn[((fraction * drawn.len() as f64) as usize).min(drawn.len() - 1)];
    Estimate { value, low: at(0.025), high: at(0.975) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let sample = (1..=200).rev().map(|k| (f64::from(k), k));
        let found = percentiles(sample, &[0.5, 0.95, 0.99]);
        assert_eq!(found.iter().map(|e| e.value).collect::<Vec<_>>(), [100.0, 190.0, 198.0]);
        assert!(found.iter().all(|e| e.low <= e.value && e.value <= e.high));
        assert!(percentiles(std::iter::empty::<(f64, u8)>(), &[0.5]).is_empty());
    }

    #[test]
    fn the_interval_of_a_mean_is_that_of_its_clusters() {
        // 100 clusters of mean 0 or 1 are worth as much as 100 values, however many rows each has.
        let rows = |each: usize| (0..100_u32).flat_map(move |k| vec![(f64::from(k % 2), k); each]);
        let (few, many) = (mean(rows(1)).unwrap(), mean(rows(50)).unwrap());
        assert!((few.value - 0.5).abs() < 1e-12 && few == many);
        // Two standard errors of 0.05 to either side.
        assert!((few.high - few.low - 0.196).abs() < 0.03, "{few:?}");
    }

    /// Catches: samples that are drawn separately, whose ratio would scatter as much as either.
    #[test]
    fn what_two_samples_have_in_common_cancels_in_their_ratio() {
        let rows: Vec<_> = (1..=200_u32).map(|k| ((1.1 * f64::from(k), f64::from(k)), k % 40)).collect();
        for ratio in ratios(&rows, 0.95).unwrap() {
            let Estimate { value, low, high } = ratio;
            assert!([value, low, high].iter().all(|v| (v - 1.1).abs() < 1e-9), "{ratio:?}");
        }
        assert_eq!(ratios::<u8>(&[], 0.5), None);
    }

    #[test]
    fn few_clusters_give_no_interval() {
        let found = mean((0..400).map(|k| (f64::from(k), k % 4))).unwrap();
        assert!((found.value - 199.5).abs() < 1e-9 && found.low.is_nan() && found.high.is_nan());
    }

    #[test]
    fn a_fraction_counts_hits() {
        let found = fraction((0..40).map(|k| (k % 4 == 0, k))).unwrap();
        assert!((found.value - 0.25).abs() < 1e-12 && found.low > 0.05 && found.high < 0.45);
        assert_eq!(fraction(std::iter::empty::<(bool, u8)>()), None);
    }
}
