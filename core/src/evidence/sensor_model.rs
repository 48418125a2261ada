//! The paper's pessimistic inverse sensor model. Paper only: used by the evaluation.

/// The paper's pessimistic inverse sensor model (Sec. "A Pessimistic Inverse Sensor Model"): a
/// return raises a cell, nothing lowers one. Paper only: used by the evaluation; the service's evidence is
/// [`Cell::mass`](super::Cell::mass).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseSensorModel {
    /// p(O): belief in a cell before any measurement, and after a scan that did not hit it.
    pub prior: f64,
    /// p^A(O | z): belief in a cell, given only a scan that hit it.
    pub hit: f64,
}

impl Default for InverseSensorModel {
    fn default() -> Self {
        Self { prior: 0.1, hit: 0.2 }
    }
}

impl InverseSensorModel {
    /// Log odds of a cell after one more scan that hit it (eq. binary-bayes).
    #[must_use]
    pub fn update(&self, log_odds_before: f64) -> f64 {
        log_odds(self.hit) - log_odds(self.prior) + log_odds_before
    }

    /// `p(O | z_1:k)` of a cell hit by `hits` scans: eq. binary-bayes, `hits` times, from the prior.
    #[must_use]
    pub fn occupancy(&self, hits: u32) -> f64 {
        let gain = self.update(0.0);
        probability(log_odds(self.prior) + f64::from(hits) * gain)
    }

    /// Evidence to correlate: occupancy with the prior subtracted, 0 where nothing is known.
    ///
    /// Correlating p itself turns the zero-padded box of the window into a bump that locks the
    /// peak to zero shift.
    #[must_use]
    pub fn evidence(&self, hits: u32) -> f64 {
        self.occupancy(hits) - self.prior
    }
}

/// eq. log-odds
fn log_odds(p: f64) -> f64 {
    (p / (1.0 - p)).ln()
}

/// The inverse of eq. log-odds.
fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn one_hit_is_the_papers_p_a_and_each_hit_adds_0_811() {
        let model = InverseSensorModel::default();
        assert!((model.occupancy(0) - 0.1).abs() < 1e-12);
        assert!((model.occupancy(1) - 0.2).abs() < 1e-12);
        assert!((model.update(0.0) - 0.811).abs() < 1e-3);
        // By hand: log odds of 0.1 is -2.197; three hits add 2.433; 1 / (1 + e^-0.236) = 0.5586.
        assert!((model.occupancy(3) - 0.5586).abs() < 1e-3);
        assert!(model.evidence(0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn evidence_grows_with_hits_and_stays_below_one(hits in 0..200_u32) {
            let model = InverseSensorModel::default();
            prop_assert!(model.evidence(hits + 1) >= model.evidence(hits));
            prop_assert!(model.evidence(hits) < 0.9 + 1e-12);
        }
    }
}
