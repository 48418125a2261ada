//! Percentiles, and the table beside the paper's figures.

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
        let mut sample: Vec<f64> = sample.into_iter().collect();
        sample.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let rank = (share * sample.len() as f64).ceil() as usize;
            sample.get(rank.saturating_sub(1)).copied()
        };
        Some(Self { p50: at(0.5)?, p95: at(0.95)?, p99: at(0.99)? })
    }
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
    }
}
