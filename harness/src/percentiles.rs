//! Percentiles by the nearest rank, and the paper's figures to compare with.

use serde::Serialize;

/// The paper's 95 percentiles for 5 s batches without drift (Sec. "Five-second Batches"):
/// horizontal, metres, and heading, degrees.
pub const PAPER_95: (f64, f64) = (0.44, 0.59);

/// Percentiles of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Percentiles {
    /// Half of the sample is not above this.
    pub p50: f64,
    /// 95 % of the sample are not above this.
    pub p95: f64,
    /// 99 % of the sample are not above this.
    pub p99: f64,
}

impl Percentiles {
    /// Percentiles by the nearest rank; `None` of nothing.
    pub fn of(sample: impl IntoIterator<Item = f64>) -> Option<Self> {
        let sorted = sorted(sample);
        let at = |fraction| nearest_rank(&sorted, fraction);
        Some(Self { p50: at(0.5)?, p95: at(0.95)?, p99: at(0.99)? })
    }
}

/// The value that a fraction of the sample is not above, by the nearest rank; `None` of nothing.
pub fn percentile(sample: impl IntoIterator<Item = f64>, fraction: f64) -> Option<f64> {
    nearest_rank(&sorted(sample), fraction)
}

fn sorted(sample: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut sample: Vec<f64> = sample.into_iter().collect();
    sample.sort_by(f64::total_cmp);
    sample
}

/// The value that a fraction of an ascending sample is not above; `None` of nothing.
fn nearest_rank(sorted: &[f64], fraction: f64) -> Option<f64> {
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_ranks() {
        let p = Percentiles::of((1..=200).map(f64::from)).unwrap();
        assert_eq!((p.p50, p.p95, p.p99), (100.0, 190.0, 198.0));
        assert_eq!(Percentiles::of([]), None);
        let one = Percentiles::of([3.0]).unwrap();
        assert_eq!((one.p50, one.p99), (3.0, 3.0));
        for (fraction, expected) in [(0.0, 1.0), (0.5, 100.0), (0.95, 190.0), (1.0, 200.0)] {
            assert_eq!(percentile((1..=200).map(f64::from), fraction), Some(expected), "{fraction}");
        }
    }
}
