//! What a quick run asserts: the one table of its thresholds.

use anyhow::bail;

use super::record::TrustRecord;
use super::tally::{CaseTally, Tally};

/// A figure that is bounded from above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Figure {
    /// Answers that are not usable, of all.
    Unusable,
    /// Wrong usable answers, of all questions.
    Wrong,
    /// Usable answers beyond a level, of the usable.
    Beyond,
}

/// A bound on a figure of a case: on its mean over families, and on the worst family's.
struct Bound {
    case: &'static str,
    figure: Figure,
    mean: f64,
    worst: f64,
}

const fn bound(case: &'static str, figure: Figure, mean: f64, worst: f64) -> Bound {
    Bound { case, figure, mean, worst }
}

/// The thresholds. They hold what was reached; what is wanted is a wrong answer in 1000 questions, a level exceeded by one
/// usable answer in 1000, and 97 % usable where the prior is right and the street is not its own double. A quick run asks
/// too little to show a rate of 1e-3: it shows that nothing got worse.
const BOUNDS: [Bound; 13] = [
    bound("right", Figure::Unusable, 0.25, 1.0),
    bound("right", Figure::Wrong, 0.01, 0.09),
    bound("right", Figure::Beyond, 0.02, 0.2),
    bound("no Doppler", Figure::Unusable, 0.28, 1.0),
    bound("batch of 1 s", Figure::Wrong, 0.01, 0.17),
    bound("batch of 8 s", Figure::Wrong, 0.01, 0.17),
    bound("4 sigma along", Figure::Wrong, 0.01, 0.17),
    bound("12 to 30 m off", Figure::Wrong, 0.005, 0.09),
    bound("wrong street", Figure::Wrong, 0.015, 0.17),
    bound("unmapped street", Figure::Wrong, 0.015, 0.17),
    bound("map ends", Figure::Wrong, 0.015, 0.17),
    bound("clock late 50 ms", Figure::Beyond, 0.2, 1.0),
    bound("odometry jumps 5 m 0.5 s before", Figure::Wrong, 0.015, 0.17),
];

/// Checks the questions of a quick run.
///
/// # Errors
/// Names every figure that is out of bounds.
pub fn check(rows: &[TrustRecord]) -> anyhow::Result<()> {
    let broken: Vec<_> = BOUNDS.iter().filter_map(|bound| bound.broken(rows)).collect();
    if broken.is_empty() { Ok(()) } else { bail!("{}", broken.join("; ")) }
}

impl Bound {
    /// In which way it is broken, in words; `None` where it holds or nothing was asked.
    fn broken(&self, rows: &[TrustRecord]) -> Option<String> {
        let Self { case, figure, mean, worst } = self;
        let of = |tally: &Tally| match figure {
            Figure::Unusable => 1.0 - tally.usable_rate(),
            Figure::Wrong => tally.wrong_rate(),
            Figure::Beyond => tally.beyond_rate(),
        };
        let tally = CaseTally::of(case, rows);
        let (family, worst_found) = tally.worst(of)?;
        let found = tally.mean(of);
        (found > *mean || worst_found > *worst).then(|| {
            format!(
                "`{case}`, {figure:?}: {:.2} % (at most {:.2}), {:.2} % in the family `{family}` (at most {:.2})",
                100.0 * found,
                100.0 * mean,
                100.0 * worst_found,
                100.0 * worst
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::USABLE;
    use super::*;

    /// Catches: a bound that nothing breaks.
    #[test]
    fn a_bound_is_broken_by_the_mean_or_by_one_family() {
        let row = |family, along_m| TrustRecord {
            family,
            case: "right".to_owned(),
            verdict: USABLE,
            on_map: true,
            along_m,
            ..TrustRecord::default()
        };
        let mut rows = vec![row("a", 0.1); 99];
        rows.extend(vec![row("b", 0.1); 9]);
        rows.push(row("b", 3.0));
        let broken = |mean, worst| bound("right", Figure::Wrong, mean, worst).broken(&rows);
        assert_eq!(broken(0.06, 0.11), None);
        assert!(broken(0.06, 0.09).unwrap().contains("family `b`"));
        assert!(broken(0.04, 0.11).is_some());
        assert_eq!(bound("never asked", Figure::Wrong, 0.0, 0.0).broken(&rows), None);
    }
}
