//! How long fixes take, over many replicas and minutes.

/// From 1 ms up to some seconds.
const STEPS: usize = 190;
const STEP: f64 = 1.045;

/// Fixes that took longer than each of some times.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Latencies {
    longer: [f64; STEPS],
    fixes: f64,
}

impl Default for Latencies {
    fn default() -> Self {
        Self { longer: [0.0; STEPS], fixes: 0.0 }
    }
}

fn time_ms(step: usize) -> f64 {
    STEP.powi(step as i32)
}

impl Latencies {
    /// Adds fixes, by the probability that one takes longer than a time, ms.
    pub fn add(&mut self, fixes: f64, longer: impl Fn(f64) -> f64) {
        self.fixes += fixes;
        for (step, sum) in self.longer.iter_mut().enumerate() {
            let share = longer(time_ms(step));
            if share < 1e-12 {
                break;
            }
            *sum += fixes * share;
        }
    }

    pub fn merge(&mut self, other: &Self) {
        self.fixes += other.fixes;
        for (sum, more) in self.longer.iter_mut().zip(other.longer) {
            *sum += more;
        }
    }

    /// The time, ms, that this share of the fixes takes at most, to 5 %.
    pub fn quantile(&self, share: f64) -> f64 {
        let step = self.longer.iter().position(|longer| *longer <= (1.0 - share) * self.fixes);
        time_ms(step.unwrap_or(STEPS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_what_was_added() {
        let mut all = Latencies::default();
        all.add(90.0, |ms| f64::from(u8::from(ms < 2.0)));
        let mut slow = Latencies::default();
        slow.add(10.0, |ms| (-ms / 100.0_f64).exp());
        all.merge(&slow);
        assert!((all.quantile(0.5) / 2.0 - 1.0).abs() < 0.05);
        // A tenth of a tenth takes longer than 100 ms times the logarithm of ten.
        assert!((all.quantile(0.99) / 230.26 - 1.0).abs() < 0.05, "{}", all.quantile(0.99));
    }
}
